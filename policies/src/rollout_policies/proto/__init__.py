"""Generated from policy.proto by regenerate.py; not to be edited."""
