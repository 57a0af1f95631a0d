"""Teaches a small network by the scripted expert; README.md has the commands in order."""
