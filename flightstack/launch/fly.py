"""One flight of ``fly``: start of recorder, onboard process and live view; vehicle and target already run."""

from __future__ import annotations

from bridge.zenoh.zenoh_link import Role, dialled
from flightstack.common.options import shared
from flightstack.common.strict_toml import ConfigError, dumps
from flightstack.common.terminal import Terminal
from flightstack.config import load
from flightstack.config.options import OnboardOptions
from flightstack.launch.launcher import Followed, Launcher
from flightstack.launch.result import Flown
from flightstack.launch.run_options import FlyOptions
from flightstack.onboard.recording import Described, describe, log_in, new_folder
from logs.schema import Names, member_name


def run(options: FlyOptions, console: Terminal) -> Flown:
    """Fly until the onboard process has ended; the recorder starts first and ends last."""
    config, name, live = load(options.config_file), options.config_file.stem, not options.as_json
    namespace = options.namespace or member_name(config.fleet.id)
    folder = options.out or new_folder(f"fly-{name}")
    log = None if options.no_record else log_in(folder)
    folder.mkdir(parents=True, exist_ok=True)
    config_file = folder / "onboard.toml"
    config_file.write_text(dumps(config), encoding="utf-8")
    with Launcher(folder, console, tells=live, real=True) as launcher:
        if log is not None:
            launcher.record(log)
            known = {"config": name, "vehicle": options.vehicle_url, "target": options.target_key}
            describe(launcher.socket, Described(config, known, Names(namespace, options.system_id)))
        # a Zenoh client of a router cannot listen, so the live view gets no endpoint
        at = () if dialled(config_file=options.zenoh_config)[0] is Role.CLIENT else (launcher.endpoint(),)
        if options.view is not None:
            if not at:
                raise ConfigError(
                    "--view: a client of a Zenoh router has no endpoint of its own; run `flightstack watch "
                    "--view ... --connect ROUTER` beside it"
                )
            launcher.view(options.view, [(namespace, at[0], config_file)])
        socket = launcher.socket if log is not None else None
        plugged = shared(
            options, OnboardOptions, config_file=config_file, listen=(*options.listen, *at), recorder=socket
        )
        flight = Followed(launcher.start("onboard", plugged), namespace, (*at, *options.listen))
        title = f"{name}  {options.vehicle_url}  filter {config.filter}"
        shows = at and live and console.is_terminal
        problem, wall_s = launcher.fly([flight], title if shows else None)
    about = {"scenario": None, "seed": None, "config": name, "filter": config.filter}
    return Flown(about, folder, log, wall_s, (flight,), problem)
