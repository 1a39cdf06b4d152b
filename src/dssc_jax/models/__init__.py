"""The models of a loop's slots: pure functions of one draw. They never import each other."""
