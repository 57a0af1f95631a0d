"""Setup for all tests of the Python packages."""

import signal

# A shell that starts tests in the background makes them ignore Ctrl-C, which some of them send.
signal.signal(signal.SIGINT, signal.default_int_handler)
