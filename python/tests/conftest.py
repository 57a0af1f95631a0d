"""Setup for all tests of the Python packages."""

import signal

# A shell that starts the tests in the background makes Python ignore Ctrl-C, which some tests send.
signal.signal(signal.SIGINT, signal.default_int_handler)
