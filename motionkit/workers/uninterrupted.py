"""Loaded before all else by the process that workers are forked from: Ctrl-C is its parent's to handle.

Python has the server ignore it too, but only when everything is loaded, and until then prints a traceback.
"""

import signal

signal.signal(signal.SIGINT, signal.SIG_IGN)
