"""docs/how_to/autopilots.md says what the code does: its tables against the code's own."""

import re

import pytest

from bridge.mavlink.preflight.rules import RULES
from tests.unit.mavlink.client.autopilots_page import PAGE, split, tables

TEXT = PAGE.read_text()
# of the autopilots' own, named in the text as settings of a person, not of the check
SETTINGS = {
    "EKF2_EV_CTRL", "EKF2_HGT_REF", "EKF2_GPS_CTRL", "VISO_TYPE", "GPS1_TYPE", "EK3_SRC1_POSXY",
    "COM_SPOOLUP_TIME", "MPC_TKO_RAMP_T",
}  # fmt: skip


@pytest.mark.parametrize("name", tables())
def test_the_tables_are_the_codes(name):
    _, within, _ = split(TEXT, name)
    assert within == tables()[name], "run: python -m tests.unit.mavlink.client.autopilots_page"


def test_every_parameter_in_the_text_is_one_of_the_check_or_a_known_setting():
    text = re.sub(r"<!-- table.*?<!-- end -->", "", TEXT, flags=re.DOTALL)
    named = set(re.findall(r"\b(?:COM|EKF2|EK3|GUID|FS|VISO|GPS1|MPC|WPNAV)_[A-Z0-9_]+", text))
    assert named <= {rule.name for rules in RULES.values() for rule in rules} | SETTINGS
    assert len(named) >= 10
