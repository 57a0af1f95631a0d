"""Trains a small network to imitate the scripted expert; README.md lists the commands in order."""
