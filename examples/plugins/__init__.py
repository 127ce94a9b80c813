"""A reader and a writer of logs, a lens and a renderer, each in a file that a package of your own can begin with."""
