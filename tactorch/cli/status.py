"""Exit statuses of the commands, other than 0."""

#: Where the input is wrong.
WRONG = 2
#: Where Ctrl-C ended the run.
INTERRUPTED = 130
