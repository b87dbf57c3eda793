"""The sum of all forces on a scene, and which list of neighbors each term gets."""
