"""Networks that learn from simulated touch: which inclusion a map shows, and where to start."""
