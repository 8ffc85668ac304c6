"""Priors on the map of Young's modulus."""
