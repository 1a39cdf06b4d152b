"""The commands: the function ``run`` of each module takes the command's options and returns its exit code."""
