"""Why a search ended, as a log states it."""

from dataclasses import replace

import numpy as np

from tetractl.core.plan import Search, StopReason
from tetractl.log.format.codec import _decode_search, _encode_search


def test_a_reason_is_logged_as_its_text_and_an_unknown_text_still_reads():
    search = Search(1, np.zeros(1), 2.0, np.array([2.0]), 3, StopReason.TARGET)
    assert _encode_search(search).stopped == "target"
    assert _decode_search(_encode_search(search)).stopped is StopReason.TARGET
    later = _encode_search(replace(search, stopped="bored"))
    assert _decode_search(later).stopped == "bored"
