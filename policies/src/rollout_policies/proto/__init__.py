"""Generated from policy.proto by proto/regenerate.py; not to be edited."""
