"""Runnable policies: `python -m rollout_policies.examples.colour_servo`."""
