"""ROS domains for tests: each is one test process's own, and quiet when a file of tests begins.

Only the standard library is used here: the root conftest.py imports this before anything may read the environment.
"""

from __future__ import annotations

import fcntl
import gc
import os
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import IO

DOMAINS = range(30, 100)  # ports stay below those of outgoing connections
_FIRST_PORT, _PORTS = 7400, 250  # of DDS: those of domain d begin at 7400 + 250 d
_OF_PARTICIPANTS = 10  # the first of these that is one participant's own; those below are bound by who listens to all


def domains_in_use() -> set[int]:
    """Return the domains in which some process of this machine, this one too, has a participant."""
    lines = Path("/proc/net/udp").read_text().splitlines()[1:]
    ports = (divmod(int(line.split()[1].rpartition(":")[2], 16) - _FIRST_PORT, _PORTS) for line in lines)
    return {domain for domain, port in ports if port >= _OF_PARTICIPANTS}


class OwnDomains:
    """Domains that no other test process of this machine takes, until this one ends, however it ends."""

    def __init__(self, domains: Iterable[int] = DOMAINS) -> None:
        self._candidates = list(domains)
        self._locks: dict[int, IO[str]] = {}

    def quiet(self) -> int:
        """Return a domain of ours in which no node runs.

        Contexts of earlier tests keep their nodes in the graph until Python has freed them; the nodes of processes
        that are ending are there, too. A graph of the same names would be refused beside them.
        Raises RuntimeError when every domain is in use.
        """
        for free_leftovers in (lambda: None, gc.collect):
            free_leftovers()
            in_use = domains_in_use()
            for domain in self._locks:
                if domain not in in_use:
                    return domain
        return self._take(in_use)

    def _take(self, in_use: set[int]) -> int:
        folder = Path(tempfile.gettempdir()) / f"sagoma_test_domains_{os.getuid()}"
        folder.mkdir(exist_ok=True)
        for domain in self._candidates:
            if domain in in_use or domain in self._locks:
                continue
            lock = (folder / str(domain)).open("w")
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                lock.close()
                continue
            self._locks[domain] = lock
            return domain
        first, last = self._candidates[0], self._candidates[-1]
        raise RuntimeError(f"all ROS domains from {first} to {last} are in use by other test runs")
