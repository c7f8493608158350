"""The command line, one file per command; process-wide settings are made here alone."""
