"""The flight recorder: one process, many clients on a local socket, one MCAP file.

A separate process survives a crash of other processes and then closes the file; disk and compressor never
delay the control loop. Written data immediately survive a crash of the recorder, but the kernel may hold them
for half a minute, so the recorder also syncs the file to the disk. This may take long on a memory card;
during this time the clients buffer their data.
"""

from __future__ import annotations

import math
import os
import selectors
import signal
import socket
import stat
import sys
import time
from pathlib import Path

from flightstack.common.hangup import ASK, begun, handle
from logs.recorder.feed import SOCKET_PATH_MAX, WireError
from logs.recorder.recording import Client, DiskError, McapFile, Recorder, RecorderError, Statistics
from logs.schema.schemas import typestore

# Flush period in wall time, s; `recording` also flushes by log time. A killed recorder loses at most 0.5 s:
# this period and the clients' buffers (0.1 s in lockstep). A power cut also loses data since `fdatasync`.
FLUSH_PERIOD_S = 0.25
READ_PERIOD_S = 0.004  # wall time between two reads, s; reading several ticks at once saves processor time
GRACE_S = 3.0  # maximum wall time for clients to finish after a stop, s
_RECEIVE_BYTES = 2**18


class RecorderProcess:
    def __init__(self, socket_path: Path, out: Path) -> None:
        self._selector = selectors.DefaultSelector()
        self._socket_path = socket_path
        self._listener = _listen(socket_path)
        try:
            file = McapFile(out)
            _sync_directory(out.parent)
        except OSError as error:
            self._stop_listening()
            if isinstance(error, DiskError):  # the disk cannot even store the start of the file
                out.unlink()
            taken = isinstance(error, FileExistsError)
            what = "exists already; choose another name" if taken else error.strerror
            raise RecorderError(f"cannot write the log {out}: {what}") from error
        self._recorder = Recorder(file)
        self._selector.register(self._listener, selectors.EVENT_READ)
        self._clients: dict[socket.socket, Client] = {}
        self._stops = 0
        self._gone = 0

    def stop(self) -> None:
        """End after the last client or ``GRACE_S``; a second call ends at once. For signal handlers."""
        self._stops += 1

    def run(self, until_clients: int | None = None) -> Statistics:
        """Record until a stop, a disk failure, or the end of ``until_clients`` clients; return the counts.

        The file is closed at the end.
        """
        counts = self._recorder.statistics
        try:
            self._record(until_clients)
            self._finish()
        except DiskError as error:  # the clients detect the closed sockets and continue their flight
            counts.failure = error.strerror or str(error)
        for client in self._clients:
            client.close()
        self._stop_listening()
        self._selector.close()
        return counts

    def _record(self, until_clients: int | None) -> None:
        flush_s, end_s = time.monotonic() + FLUSH_PERIOD_S, math.inf
        while self._stops < 2 and time.monotonic() < end_s:
            self._pass(max(0.0, flush_s - time.monotonic()))
            if time.monotonic() >= flush_s:
                self._recorder.sync()
                flush_s = time.monotonic() + FLUSH_PERIOD_S
            if self._stops:
                end_s = min(end_s, time.monotonic() + GRACE_S)
            enough = until_clients is not None and self._gone >= until_clients
            if not self._clients and (self._stops or enough):
                return

    def _pass(self, patience_s: float) -> None:
        """Wait for data of the clients, then read from each client that has sent data."""
        ready = [key.fileobj for key, _ in self._selector.select(patience_s)]
        for fileobj in ready:
            if fileobj is self._listener:
                self._accept()
            elif isinstance(fileobj, socket.socket):
                self._receive(fileobj)
        if ready and not self._stops:
            time.sleep(READ_PERIOD_S)  # during this time more data arrive

    def _accept(self) -> None:
        while True:
            try:
                sock, _ = self._listener.accept()
            except OSError:
                return
            sock.setblocking(False)
            self._clients[sock] = self._recorder.client()
            self._selector.register(sock, selectors.EVENT_READ)

    def _receive(self, sock: socket.socket) -> bool:
        """Read the data that one client has sent; return False if there are none."""
        try:
            data = sock.recv(_RECEIVE_BYTES)
        except (BlockingIOError, InterruptedError):
            return False
        except OSError:
            data = b""
        try:
            self._recorder.take(self._clients[sock], data)
        except WireError:
            self._recorder.statistics.invalid += 1
            data = b""
        if not data:
            self._drop(sock)
        return bool(data)

    def _drop(self, sock: socket.socket) -> None:
        self._gone += 1
        self._selector.unregister(sock)
        sock.close()
        self._recorder.gone(self._clients.pop(sock))

    def _finish(self) -> None:
        """Read the remaining data of the sockets for at most ``GRACE_S``, and close the file."""
        self._accept()
        deadline_s = time.monotonic() + GRACE_S
        for sock in list(self._clients):
            while time.monotonic() < deadline_s and self._receive(sock):
                pass
        for sock in list(self._clients):
            self._drop(sock)
        self._recorder.finish()

    def _stop_listening(self) -> None:
        self._listener.close()
        self._socket_path.unlink(missing_ok=True)


def _listen(path: Path) -> socket.socket:
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        _remove_stale(path)
        before = os.umask(0o177)  # only this user may connect to the socket
        try:
            listener.bind(str(path))
        finally:
            os.umask(before)
        listener.listen(64)
    except OSError as error:
        listener.close()
        hint = ""
        if len(str(path)) > SOCKET_PATH_MAX:
            hint = f"; paths of sockets have at most {SOCKET_PATH_MAX} bytes"
        raise RecorderError(f"cannot listen at {path}: {error}{hint}") from error
    listener.setblocking(False)
    return listener


def _remove_stale(path: Path) -> None:
    """Remove the socket of a killed recorder; a socket that replies remains and makes the bind fail."""
    if not path.exists() or not stat.S_ISSOCK(path.stat().st_mode):
        return
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        try:
            probe.connect(str(path))
        except ConnectionRefusedError:
            path.unlink(missing_ok=True)


def _sync_directory(directory: Path) -> None:
    descriptor = os.open(directory, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


__all__ = ["RecorderError", "RecorderProcess", "problems", "record_main"]


def record_main(socket_path: Path, out: Path, until_clients: int | None = None) -> int:
    """Run the recorder as the main program of a process; print "ready" when clients can connect.

    Return the exit status. 0: all data are in the file; 1: some data are missing; 2: no start.
    """
    try:
        process = RecorderProcess(socket_path, out)
    except RecorderError as error:
        print(f"record: {error}", file=sys.stderr)
        return 2
    handle(dict.fromkeys((*ASK, signal.SIGHUP), process.stop))
    begun()
    typestore()  # call it before the flight, since the first call takes half a second
    print("ready", flush=True)
    counts = process.run(until_clients)
    for problem in problems(counts):
        print(f"record: {out}: {problem}", file=sys.stderr)
    return 1 if problems(counts) else 0


def problems(counts: Statistics) -> list[str]:
    """Return one line for each reason why the file is incomplete."""
    found: list[str] = []
    if counts.failure:
        found.append(f"writing failed ({counts.failure}); the later messages are missing")
    for client, dropped in sorted(counts.dropped.items()):
        if dropped:
            found.append(f"{client} dropped {dropped} records, the recorder did not keep up")
    if counts.invalid:
        found.append(f"{counts.invalid} invalid records")
    if counts.crashed:
        found.append(
            f"{counts.crashed} clients ended without a goodbye, "
            f"{counts.unfinished_bytes} bytes of unfinished records lost"
        )
    return found
