"""Tests the table of the messages that pymavlink's dialect lacks."""

import pytest
from pymavlink.dialects.v20 import all as everything
from pymavlink.dialects.v20 import common, development, standard

from bridge.mavlink.codec.messages import MESSAGES
from tests import tables


def test_table_is_what_its_command_makes_of_the_installed_pymavlink():
    assert tables.MESSAGES.read_text() == tables.messages_table()


@pytest.mark.parametrize("other", [everything, common, development, standard])
def test_every_message_of_pymavlinks_dialects_is_known(other):
    for id_, cls in other.mavlink_map.items():
        assert (MESSAGES[id_].msgname, MESSAGES[id_].crc_extra) == (cls.msgname, cls.crc_extra)
