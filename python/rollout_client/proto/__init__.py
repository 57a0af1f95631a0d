"""Modules generated from coordinator.proto by proto/regenerate.py; do not edit them."""
