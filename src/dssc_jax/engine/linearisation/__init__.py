"""The loop linearised part by part: where a part has a slope, and which substitute replaces a part without one."""
