"""How far one surface lies from another: faces in a tree, the foot of each vertex, one side as it is worked on."""
