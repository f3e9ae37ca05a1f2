"""Single pieces to place in a scene, each drawn about its own origin on the ground, meters, z up, facing -y."""
