from tetractl.core.registries import COMMANDS, LAB_COMMANDS, all_registries
from tetractl.tools.retired import INSTEAD


def test_no_retired_name_is_a_kind():
    groups = {group.group: group for group in (*all_registries(), COMMANDS, LAB_COMMANDS)}
    for group, name in INSTEAD:
        if group in groups:
            assert name not in groups[group]
