"""What holds for all tests of the Python packages."""

import signal

# A shell that runs tests in the background has them ignore Ctrl-C, which some of them send.
signal.signal(signal.SIGINT, signal.default_int_handler)
