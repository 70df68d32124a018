"""The system around a command: files, locks, processes, messages and the machine."""
