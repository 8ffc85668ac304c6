"""Posteriors: of element maps, and of inclusions, in coordinates in which they are normal."""
