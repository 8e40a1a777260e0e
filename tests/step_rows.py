"""Rows of controller steps for tests; fields come from the definition of the message."""

from bridge.ros2.codec import CODES, HEADER_TYPE
from logs.schema.rows import ControllerStepRow
from logs.schema.schemas import CONTROLLER_STEP, Field, fields_of


def _zero(field: Field):
    if field.kind == HEADER_TYPE:
        return 0
    if field.kind not in CODES:
        return tuple(map(_zero, fields_of(field.kind)))
    return {"?": False, "d": 0.0, "f": 0.0}.get(CODES[field.kind], 0)


_ZEROS = ControllerStepRow(*map(_zero, fields_of(CONTROLLER_STEP)))


def step_row(**given) -> ControllerStepRow:
    """Return a step with these fields; all other fields are zero."""
    return _ZEROS._replace(**given)
