"""The recognizer: which inclusion a map of Young's modulus shows (Section V-B)."""
