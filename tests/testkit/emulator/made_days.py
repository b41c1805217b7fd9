"""Made-up events and logs of rehearsed days for tests."""

from tetractl.log.read.trial_log import TrialLog


def at(seconds, event, **facts):
    return {"t_ns": round(seconds * 1e9), "event": event, **facts}


def give_log(truth, **fields):
    """Give a day a log with these fields; all others are None."""
    empty = dict.fromkeys(TrialLog.__dataclass_fields__)
    vars(truth)["log"] = TrialLog(**empty | fields)
