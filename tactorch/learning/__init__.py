"""Networks trained on simulated presses: a recognizer of inclusions and a surrogate for starts."""
