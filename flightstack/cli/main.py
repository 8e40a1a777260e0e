"""The command ``flightstack``: verbs only, the work is elsewhere."""

from __future__ import annotations

import os
from importlib import import_module
from typing import Any

import click

from flightstack.common.strict_toml import ConfigError

WRONG_INPUT = 2

# Matrices here are small: numpy's threads would cost each process 0.1 s when it starts, and help nothing.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

CONTEXT = {"help_option_names": ["-h", "--help"], "max_content_width": 110}
# where each verb is; a process of a flight loads its own alone
VERBS = {
    "bridge": "flightstack.cli.real.bridge:bridge",
    "campaign": "flightstack.cli.prove.campaign:campaign",
    "check": "flightstack.cli.prove.check:check",
    "compare": "flightstack.cli.logs.log:diff",
    "config": "flightstack.cli.real.config:config",
    "fly": "flightstack.cli.fly.fly:fly",
    "identify": "flightstack.cli.prove.identify:identify",
    "key": "flightstack.cli.real.key:key",
    "log": "flightstack.cli.logs.log:log",
    "onboard": "flightstack.cli.fly.onboard:onboard",
    "preflight": "flightstack.cli.fly.preflight:preflight",
    "px4-sim": "flightstack.cli.real.px4_sim:px4_sim",
    "record": "flightstack.cli.logs.record:record",
    "replay": "flightstack.cli.prove.replay:replay",
    "report": "flightstack.cli.logs.record:report",
    "router": "flightstack.cli.zenoh:router",
    "scenarios": "flightstack.cli.fly.simulator:scenarios",
    "sitl": "flightstack.cli.fly.sitl:sitl",
    "target": "flightstack.cli.fly.simulator:target",
    "vehicle": "flightstack.cli.fly.simulator:vehicle",
    "view": "flightstack.cli.logs.view:view",
    "watch": "flightstack.cli.fly.watch:watch",
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
