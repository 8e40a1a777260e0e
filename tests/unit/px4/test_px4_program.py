"""Tests which parameters the process of PX4 gets; a script replaces PX4 and its console."""

import pytest

from sim.px4.program import Px4Model, Px4Program

# Each parameter of the script is a file; a command with an unknown parameter fails.
STAND_IN = """#!/bin/sh
cd "$(dirname "$0")/.."
case "$(basename "$0") $1" in
  "px4 "*) echo 'Startup script returned successfully'; echo 'Ready for takeoff!'; exec sleep 60;;
esac
shift 2; verb=$1; name=$2; value=$3
[ -e "values/$name" ] || exit 1
case $verb in
  compare) [ "$(cat "values/$name")" = "$value" ];;
  set) echo "$value" > "values/$name";;
  reset) echo reset > "values/$name";;
esac
"""


@pytest.fixture
def build(tmp_path):
    """Return the folder of a fake build of PX4 that knows three parameters."""
    (tmp_path / "etc").mkdir()
    (tmp_path / "px4-alias.sh").write_text("alias param='px4-param --instance 0'\n")
    (tmp_path / "px4").write_text(STAND_IN)
    (tmp_path / "px4").chmod(0o755)
    values = tmp_path / "run" / "values"
    values.mkdir(parents=True)
    for name in ("COM_OBL_RC_ACT", "COM_OF_LOSS_T", "COM_RC_IN_MODE"):
        (values / name).write_text("0\n")
    return tmp_path


@pytest.mark.parametrize("speed", [1.0, 5.0])
def test_what_the_release_has_is_set_and_what_it_has_not_is_named(build, speed):
    """PX4 1.18 removed COM_OBC_LOSS_T and renamed others: neither change prevents a flight."""
    wanted = {"COM_OBL_RC_ACT": 4, "COM_RC_IN_MODE": 0, "SYS_HAS_GPS": 0}
    px4 = Px4Program(
        build, build / "run", Px4Model.SIHSIM_QUADX, parameters=wanted, speed=speed, origin_wgs84=None
    )
    try:
        px4.wait_ready(20.0)
        found = {file.name: file.read_text().strip() for file in (build / "run" / "values").iterdir()}
    finally:
        px4.end()
    assert px4.absent == ["SYS_HAS_GPS"]
    scaled = "reset" if speed != 1.0 else "0"
    assert found == {"COM_OBL_RC_ACT": "4", "COM_RC_IN_MODE": "0", "COM_OF_LOSS_T": scaled}
