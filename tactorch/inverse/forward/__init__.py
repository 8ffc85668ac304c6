"""Presses at a field of Young's modulus: equilibria, predictions and their derivatives."""
