"""Generated from coordinator.proto by proto/regenerate.py; not to be edited."""
