"""Compares the time that a program needs to stop with the time that it is given."""

import re

UNITS = {"": 1, "s": 1, "m": 60, "min": 60, "h": 3600}
# The worker's default --grace, then 10 s for delivery and 5 s for deregistration.
GRACE_S = 10
AFTER_GRACE_S = 15
COORDINATOR_S = 10
TO_SPARE_S = 5


def seconds(text):
    match = re.fullmatch(r"(\d+) ?([a-z]*)", str(text))
    if not match or match[2] not in UNITS:
        raise SystemExit(f"{text!r} is not a time such as 45s")
    return int(match[1]) * UNITS[match[2]]


def enough_to_stop(where, command, given_s, grace=None):
    """Yields a problem if a program would be killed before it has ended by itself."""
    for word in command:
        if word.startswith("--grace="):
            grace = word.partition("=")[2]
    if command[0].endswith("farm-worker"):
        needed_s = (GRACE_S if grace is None else seconds(grace)) + AFTER_GRACE_S + TO_SPARE_S
    else:
        needed_s = COORDINATOR_S + TO_SPARE_S
    if given_s < needed_s:
        yield f"{where}: {given_s} s to stop are not enough: {needed_s} s are needed"
