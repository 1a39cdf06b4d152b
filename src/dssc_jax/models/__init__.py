"""Models for the slots of a loop: pure functions of one draw that never import each other."""
