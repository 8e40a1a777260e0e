"""Configurations of fleet members."""

from tests.unit.core.core_helpers import config

RATE_HZ = 50
DT_S = 1.0 / RATE_HZ
MEMBERS = (3, 7)


def fleet(members=MEMBERS, **keys):
    return {"id": members[0], "members": list(members), **keys}


def settings_of(id_, members, fleet_keys=None, **sections):
    table = {**fleet(members), **(fleet_keys or {}), "id": id_}
    limits = {"velocity_max_m_s": [0.5, 0.5, 0.5], "altitude_max_m": 6.0}
    return config(loop={"rate_hz": RATE_HZ}, limits=limits, fleet=table, **sections)
