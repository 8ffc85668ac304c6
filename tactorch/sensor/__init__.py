"""From camera frames and poses of a tactile sensor to a recording of presses (Section VI)."""
