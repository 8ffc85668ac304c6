"""Readers of mesh and surface files."""
