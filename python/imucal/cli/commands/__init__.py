"""The commands of the command line tool `imucal`, one module for each command or group of commands."""
