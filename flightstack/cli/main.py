"""The command ``flightstack``: it finds and runs a subcommand, whose functions are in other packages."""

from __future__ import annotations

import os
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import click

from flightstack.common import hangup
from flightstack.common.processes import LaunchError
from flightstack.common.strict_toml import ConfigError
from flightstack.common.text import needed_by, plain

INTERRUPTED, WRONG_INPUT = 1, 2

# The stack's matrices are small: numpy's threads would only delay the start of each process by 0.1 s.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

CONTEXT = {"help_option_names": ["-h", "--help"], "max_content_width": 110}


class Verb(NamedTuple):
    """A subcommand: module and function, which are loaded when it is called, and its line in ``--help``."""

    place: str
    help: str


# subcommands in the groups of ``--help``
GROUPS = {
    "Fly": {
        "sitl": Verb("flight:sitl", "Fly a scenario in software, with everything it needs."),
        "fly": Verb("flight:fly", "Fly a real vehicle onto a real target."),
        "preflight": Verb("real:preflight", "Check the vehicle's safety parameters."),
        "onboard": Verb("flight:onboard", "Run the onboard process alone."),
        "world": Verb("flight:world", "Run the simulated vehicles and robots."),
        "vehicle": Verb("flight:vehicle", "Run the simulated Crazyflie alone."),
        "target": Verb("flight:target", "Run the simulated ground robot alone."),
        "watch": Verb("flight:watch", "Show a flight while it flies."),
        "scenarios": Verb("prepare:scenarios", "List the scenarios, or print one."),
        "new": Verb("prepare:new", "Write a scenario of your own."),
    },
    "Prove": {
        "check": Verb("check:check", "Prove a configuration before flight."),
        "campaign": Verb("campaign:campaign", "Fly many seeds; give rates with bounds."),
        "replay": Verb("logs:replay", "Run a log through today's controller."),
        "validate": Verb("campaign:validate", "Compare the simulator with recorded flights."),
        "identify": Verb("logs:identify", "Identify velocity loop and noise from logs."),
    },
    "Logs": {
        "report": Verb("logs:report", "Write the report of a log."),
        "compare": Verb("logs:compare", "Compare two logs message by message."),
        "view": Verb("logs:view", "Show a log in 3-D."),
        "log": Verb("logs:log", "Inspect, judge, repair, export logs."),
        "record": Verb("logs:record", "Run the recorder alone."),
    },
    "Real things": {
        "config": Verb("prepare:config", "List the configurations, or print one."),
        "bridge": Verb("real:bridge", "Connect a Crazyflie or motion capture."),
        "px4-sim": Verb("flight:px4_sim", "Simulate the vehicle for PX4's autopilot."),
        "router": Verb("prepare:router", "Run a Zenoh router."),
        "key": Verb("prepare:key", "Make a MAVLink signing key."),
    },
}
# subcommands whose exit status remains that of the flight if their output is lost
FLIES = (
    "sitl", "fly", "onboard", "world", "vehicle", "target", "record", "bridge", "px4-sim", "campaign"
)  # fmt: skip
VERBS = {name: verb for group in GROUPS.values() for name, verb in group.items()}


def _hidden(error: BaseException) -> str | None:
    """Return an error text if a package of another project hides one of this project; else None."""
    name = (getattr(error, "name", None) or "").partition(".")[0]
    if not isinstance(error, ImportError) or name not in ("bridge", "logs", "sim"):
        return None
    ours = Path(__file__).parents[2] / name
    spec = find_spec(name)
    found = [] if spec is None else [*(spec.submodule_search_locations or ()), *filter(None, [spec.origin])]
    if not found or str(ours) in found:
        return None
    return (
        f"the Python package {name!r} at {found[0]} belongs to another project and hides the one at {ours}: "
        "take it out of PYTHONPATH, or uninstall it from this environment"
    )


class Verbs(click.Group):
    """Group of subcommands; it loads the called one, and reports wrong input in one line (exit status 2)."""

    verb = ""  # name of the called subcommand

    def main(self, *args: Any, **kwargs: Any) -> Any:
        """Run the command, also after the reader of its output has ended; no signal at its start is lost."""
        if hangup.guard():  # False in a test, which has replaced the output
            hangup.start()
        try:
            return super().main(*args, **kwargs)
        except SystemExit as ended:
            problem = hangup.problem()
            if problem is None:
                raise
            click.echo(f"flightstack: standard output is not complete: {problem}", err=True)
            raise SystemExit(ended.code or (0 if self.verb in FLIES else WRONG_INPUT)) from None

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names of all subcommands, in the order of their groups."""
        del ctx
        return list(VERBS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Return the subcommand of this name; None if there is none."""
        del ctx
        if cmd_name not in VERBS:
            return None
        self.verb = cmd_name
        module, _, name = VERBS[cmd_name].place.partition(":")
        command: click.Command = getattr(import_module(f"flightstack.cli.{module}"), name)
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the subcommands in their groups."""
        del ctx
        for title, verbs in GROUPS.items():
            with formatter.section(title):
                formatter.write_dl([(name, verb.help) for name, verb in verbs.items()])

    def invoke(self, ctx: click.Context) -> Any:
        """Run the subcommand."""
        try:
            with needed_by("this command"):
                return super().invoke(ctx)
        except click.exceptions.Exit:
            raise
        except (hangup.CalledOffError, Exception) as error:
            called_off = hangup.called_off()  # a loading library can have converted the signal to an error
            hidden = _hidden(error)
            known = isinstance(error, (ConfigError, ValueError, OSError, LaunchError))
            if called_off is None and hidden is None and not known:
                raise
            click.echo(f"flightstack: {plain(called_off or hidden or error)}", err=True)
            status = error.code if isinstance(error, LaunchError) else WRONG_INPUT
            ctx.exit(INTERRUPTED if called_off else status)


@click.group(cls=Verbs, context_settings=CONTEXT)
@click.version_option(package_name="crazyflie-flightstack", message="flightstack %(version)s")
def main() -> None:
    """Land a Crazyflie safely on a moving target, over MAVLink and Zenoh, and record all data."""


if __name__ == "__main__":
    main()
