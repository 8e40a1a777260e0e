"""The command ``flightstack``: verbs only, the work is elsewhere."""

from __future__ import annotations

import os
from importlib import import_module
from typing import Any

import click

from flightstack.strict_toml import ConfigError

WRONG_INPUT = 2

# Matrices here are small: numpy's threads would cost each process 0.1 s when it starts, and help nothing.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

CONTEXT = {"help_option_names": ["-h", "--help"], "max_content_width": 110}
# where each verb is; a process of a flight loads its own alone
VERBS = {
    "bridge": "flightstack.cli_bridge:bridge",
    "campaign": "sim.campaign.verb:campaign",
    "check": "flightstack.cli_check:check",
    "compare": "flightstack.cli_log:diff",
    "config": "flightstack.cli_config:config",
    "fly": "flightstack.cli_fly:fly",
    "identify": "flightstack.cli_identify:identify",
    "key": "flightstack.cli_key:key",
    "log": "flightstack.cli_log:log",
    "onboard": "flightstack.cli_onboard:onboard",
    "preflight": "flightstack.cli_preflight:preflight",
    "px4-sim": "sim.px4.verb:px4_sim",
    "record": "flightstack.cli_record:record",
    "replay": "flightstack.cli_replay:replay",
    "report": "flightstack.cli_record:report",
    "router": "flightstack.cli_zenoh:router",
    "scenarios": "sim.verbs:scenarios",
    "sitl": "flightstack.cli_sitl:sitl",
    "target": "sim.verbs:target",
    "vehicle": "sim.verbs:vehicle",
    "view": "flightstack.cli_view:view",
    "watch": "flightstack.cli_watch:watch",
}


class Verbs(click.Group):
    """Loads a verb when it is called, and turns wrong input into one clear line and exit status 2."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names of all verbs."""
        del ctx
        return sorted(VERBS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """The verb of this name, None if there is none."""
        del ctx
        if cmd_name not in VERBS:
            return None
        module, _, name = VERBS[cmd_name].partition(":")
        verb: click.Command = getattr(import_module(module), name)
        return verb

    def invoke(self, ctx: click.Context) -> Any:
        """Run the verb."""
        try:
            return super().invoke(ctx)
        except (ConfigError, ValueError, OSError) as error:
            click.echo(f"flightstack: {error}", err=True)
            ctx.exit(WRONG_INPUT)


@click.group(cls=Verbs, context_settings=CONTEXT)
@click.version_option(package_name="crazyflie-flightstack", message="flightstack %(version)s")
def main() -> None:
    """Land a Crazyflie on a moving target: safely, over MAVLink and Zenoh, everything recorded."""


if __name__ == "__main__":
    main()
