from tetractl.experiment.yaml.document import parse_document
from tetractl.experiment.yaml.settings import with_settings


def test_settings_leave_the_parsed_document_as_it_was():
    document = parse_document("robots: [{name: red, a: 3}]", "s.yaml")
    changed = with_settings(document, ["robots.red.a=4", "robots.red.a=5", "nonsense"])
    assert changed.data == {"robots": [{"name": "red", "a": 5}]}
    assert document.data == {"robots": [{"name": "red", "a": 3}]}
    assert document.place(("robots", 0, "a")).origin == "s.yaml"
    assert document.problems == []
