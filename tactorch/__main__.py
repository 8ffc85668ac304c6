"""`python -m tactorch VERB` is `tactorch VERB`."""

from tactorch.cli import main

if __name__ == "__main__":
    main()
