"""Commands that prepare a flight: configurations, scenarios, signing keys, a Zenoh router."""

from __future__ import annotations

import shutil
import signal
import sys
import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import click

from flightstack.common.options import Option, arguments
from flightstack.common.strict_toml import ConfigError, decoded
from flightstack.config import options as shared


@click.command()
@arguments
def config(name: Annotated[str | None, Option("[NAME]")] = None) -> None:
    """List the packaged configurations of the onboard process, or print the one with the given NAME."""
    from flightstack import config as known

    def purpose(each: str) -> str:  # the first line of a file is a comment with its purpose
        return known.path_of(each).read_text("utf-8").partition("\n")[0].removeprefix("# ")

    _show(known, name, purpose)


@click.command()
@arguments
def scenarios(name: Annotated[str | None, Option("[NAME]")] = None) -> None:
    """List the scenarios of the simulator, or print the one with the given NAME."""
    from sim.scenarios import scenario

    _show(scenario, name, lambda each: scenario.load(each).description)


def _show(files: Any, name: str | None, purpose: Callable[[str], str]) -> None:
    """Print the file of this name; without a name, list all with their purposes."""
    if name is not None:
        click.echo(decoded(files.path_of(name).read_bytes()), nl=False)
        return
    listed = {known: purpose(known) for known in files.names()}
    wide = max(map(len, listed)) + 2
    columns = max(shutil.get_terminal_size().columns, wide + 40)
    for known, text in listed.items():
        lines = textwrap.wrap(text, columns - wide)
        click.echo("\n".join([f"{known:{wide}}{lines[0]}", *(" " * wide + line for line in lines[1:])]))


@click.command()
@arguments
def new(
    what: Annotated[str, Option("{scenario}", choices=("scenario",))],
    name: Annotated[str, Option("NAME")],
    base: Annotated[str, Option("--base", "Name of the scenario from which it starts.")] = "lab",
) -> None:
    """Write NAME.toml to this folder: a scenario based on another one, with a comment for each key.

    Exit status: 0 written, 2 wrong name, or the file exists.
    """
    del what
    from sim.scenarios.keys import commented

    file, text = Path(f"{name}.toml"), commented(name, base)
    try:
        with file.open("x", encoding="utf-8") as out:
            out.write(text)
    except FileExistsError:
        raise ConfigError(f"{file}: exists and is not overwritten; choose another name") from None
    except OSError as error:
        file.unlink(missing_ok=True)
        raise ConfigError(f"{file}: cannot be written: {error.strerror}") from None
    click.echo(f"{file}: fly it with `flightstack sitl --scenario {file} --lockstep`")


@click.command()
@arguments
def key(file: Annotated[Path, Option("FILE", path="file")]) -> None:
    """Write a new MAVLink signing key to FILE, readable only by its owner (docs/how_to/security.md)."""
    from bridge.mavlink.signing import make_key

    make_key(file)
    click.echo(f"{file}: a new signing key; give it to both ends as --signing-key, over a channel you trust")


@click.command()
@arguments
def router(
    listen: Annotated[tuple[str, ...], Option(
        "--listen", "Endpoint to listen on; default: the configuration's, or tcp/127.0.0.1:7447; repeatable.",
        "ENDPOINT"
    )] = (),
    connect: shared.Connect = (),
    zenoh_config: shared.ZenohConfig = None,
) -> None:  # fmt: skip
    """Run a Zenoh router, to which robot, companion, watchers and ROS 2 nodes connect.

    The router replaces zenohd or rmw_zenohd if neither is installed. Ctrl-C or SIGTERM ends it.
    """
    from bridge.zenoh import zenoh_link

    ends = {signal.SIGINT, signal.SIGTERM}
    signal.pthread_sigmask(signal.SIG_BLOCK, ends)  # Zenoh's threads start later and inherit this mask
    role = zenoh_link.Role.ROUTER
    try:
        if (
            zenoh_config is not None
            and zenoh_link.dialled(config_file=zenoh_config, role=role)[0] is not role
        ):
            raise ValueError(f'{zenoh_config}: mode "router" is needed, or none')
        session = zenoh_link.open_session(listen, connect, config_file=zenoh_config, role=role)
    except zenoh_link.ZenohLinkError as error:
        click.echo(f"flightstack: {error}", err=True)
        sys.exit(1)
    try:
        click.echo("ready")
        signal.sigwait(ends)
    finally:
        session.close()
        signal.pthread_sigmask(signal.SIG_UNBLOCK, ends)
