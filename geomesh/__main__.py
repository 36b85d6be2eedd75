"""`python -m geomesh`: the command line, by way of a certain interpreter."""

from geomesh.cli import main

if __name__ == "__main__":
    main()
