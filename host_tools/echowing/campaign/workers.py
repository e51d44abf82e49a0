"""Spreads calls over Dask workers: each is done once, in any order, and the caller may stop.

Dask hands out the work, detects a worker that dies, and gives its calls to another.
"""

import signal
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from queue import Empty, Queue
from typing import Any, TypeVar

from dask import config
from distributed import Client, Future, LocalCluster
from distributed.scheduler import KilledWorker

from echowing.errors import EchowingError

Key = TypeVar("Key")
# So many calls for each worker are handed out at a time: none waits, and few are lost on a stop.
AHEAD = 3
# A call may lose so many workers before it is given up: then the call itself kills them.
MOST_DEATHS = 3
CONNECT_S = 10.0
RESTART_S = 20.0
# A dead worker is back within seconds; on a busy machine within a minute.
NO_WORKERS_S = 180.0
POLL_S = 0.2


class WorkersDied:
    """The result of a call after which its worker was dead, again and again."""


@contextmanager
def connected(workers: int, scheduler: str | None) -> Iterator[Client]:
    """A user's scheduler, or a cluster of this machine's own processes, on loopback only.

    Raises EchowingError where there is no scheduler, or it has no workers.
    """
    if scheduler is None:
        with _local(workers) as client:
            yield client
        return
    try:
        client = Client(scheduler, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise EchowingError(
            f"--scheduler {scheduler}: no Dask scheduler answers there: start one with "
            "`dask scheduler`, and its workers with `dask worker`"
        ) from error
    with client:
        if not client.nthreads():
            raise EchowingError(f"--scheduler {scheduler}: has no workers: start `dask worker`")
        yield client


@contextmanager
def _local(workers: int) -> Iterator[Client]:
    options = {
        "distributed.scheduler.allowed-failures": MOST_DEATHS - 1,
        # One call at a time on a worker: those that wait there are blamed for its death too.
        "distributed.scheduler.worker-saturation": 1.0,
        "distributed.admin.log-format": "%(message)s",
        "logging": {"distributed": "critical"},
    }
    with config.set(options), _ctrl_c_is_ours():
        cluster = LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            processes=True,
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",
            silence_logs=50,
        )
    with config.set(options), cluster, Client(cluster, set_as_default=False) as client:
        try:
            yield client
        finally:
            # Closing a cluster while a dead worker is being restarted would never end.
            with suppress(TimeoutError):
                client.wait_for_workers(workers, timeout=RESTART_S)


@contextmanager
def _ctrl_c_is_ours() -> Iterator[None]:
    """Processes that are started here ignore the terminal's Ctrl-C: we decide when they end."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def done_by_workers(
    client: Client,
    call: Callable[..., Any],
    shared: Any,
    keys: Iterable[Key],
    stop: Callable[[], bool] = lambda: False,
) -> Iterator[tuple[Key, Any]]:
    """`call(shared, key)` for each key, as they are done; ends early once `stop()`.

    What a call raises is raised here; WorkersDied is given back as the result.
    """
    done: Queue[tuple[Key, Future]] = Queue()
    waiting = iter(keys)
    under_way: dict[Key, Future] = {}

    def hand_out() -> None:
        most = AHEAD * max(1, len(client.nthreads()))
        while len(under_way) < most:
            key = next(waiting, None)
            if key is None:
                return
            future = client.submit(call, shared, key, pure=False)
            under_way[key] = future
            future.add_done_callback(lambda future, key=key: done.put((key, future)))

    hand_out()
    seen_s = time.monotonic()
    while under_way and not stop():
        try:
            key, future = done.get(timeout=POLL_S)
        except Empty:
            if client.nthreads():
                seen_s = time.monotonic()
            elif time.monotonic() - seen_s > NO_WORKERS_S:
                raise EchowingError(
                    f"no worker is left since {NO_WORKERS_S:g} s: start workers, then go on with "
                    "--resume"
                ) from None
            continue
        if not future.done():  # it was, and was lost with its worker: it is being done again
            time.sleep(POLL_S)
            done.put((key, future))
            continue
        del under_way[key]
        yield key, _result(future)
        hand_out()
    client.cancel(list(under_way.values()))


def _result(future: Future) -> Any:
    error = future.exception()
    if isinstance(error, KilledWorker):
        return WorkersDied()
    if error is not None:
        raise error
    return future.result()
