"""What a scene is: atoms, cell, bonds, units; what is held fixed; what can be measured on a state."""
