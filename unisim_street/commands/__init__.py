"""Commands of the command line that streets bring."""
