"""Commands of `tactorch sensor`: a file for each, and what they share."""
