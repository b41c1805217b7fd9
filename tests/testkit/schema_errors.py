"""The errors that data from YAML can cause in a pydantic schema."""

from tetractl.spec.explain_errors import MESSAGES

ERRORS = {  # of a schema, those that data out of YAML can cause in strict mode
    "int": {"int_type", "int_from_float"}
    | {"greater_than", "greater_than_equal", "less_than", "less_than_equal"},
    "float": {"float_type", "finite_number"},
    "bool": {"bool_type"},
    "str": {"string_type", "string_unicode", "string_too_short", "string_too_long"}
    | {"string_pattern_mismatch"},
    "tuple": {"tuple_type", "too_short", "too_long", "missing"},
    "dict": {"dict_type", "too_long"},
    "none": {"none_required"},
    "model": {"model_type"},
    "model-fields": {"model_attributes_type", "missing", "extra_forbidden"},
    "literal": {"literal_error"},
}
SILENT = {  # can cause no error, or one that is raised with words of its own
    "any", "default", "definition-ref", "definitions", "function-after", "function-before",
    "function-plain", "function-wrap", "is-instance", "model-field", "nullable", "no-info",
    "tagged-union", "union", "with-info",
}  # fmt: skip


def kinds_of(schema):
    """Yield the kinds of schemas in a schema."""
    if isinstance(schema, dict):
        if isinstance(schema.get("type"), str):
            yield schema["type"]
        for key, value in schema.items():
            if key not in ("metadata", "serialization", "default", "expected"):
                yield from kinds_of(value)
    elif isinstance(schema, list | tuple):
        for item in schema:
            yield from kinds_of(item)


def without_words(*models):
    """Return kinds of schemas that are not known here, and errors without words of tetractl."""
    kinds = {kind for model in models for kind in kinds_of(model.__pydantic_core_schema__)}
    errors = {error for kind in kinds & set(ERRORS) for error in ERRORS[kind]}
    return (kinds - SILENT - set(ERRORS)) | (errors - set(MESSAGES))
