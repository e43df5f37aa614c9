"""Warnings that stop nothing, sent to the logger `motionkit`.

Python prints them on stderr unless logging is configured; the command line prints them with a prefix.
"""

import logging

LOGGER = logging.getLogger("motionkit")


def warn(message: str) -> None:
    """Log a warning of one sentence."""
    LOGGER.warning("%s", message)
