"""The command line: what it can say. Modules import what a command does when it is done, so that help comes soon."""
