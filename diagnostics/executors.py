"""Work by number on any executor: in this process, in threads, in others, on a cluster."""

import functools
import pickle
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Executor, ThreadPoolExecutor, wait
from contextlib import ExitStack
from typing import Any, Protocol

import jax

try:
    from cloudpickle import dumps
except ImportError:  # an extra: it sends functions that no module holds, too
    from pickle import dumps

# Numbers depend on them, and neither threads nor processes inherit them all.
_FLAGS = {
    "jax_enable_x64": jax.enable_x64,
    "jax_default_matmul_precision": jax.default_matmul_precision,
    "jax_default_prng_impl": jax.default_prng_impl,
    "jax_threefry_partitionable": jax.threefry_partitionable,
}
# Enough for any cluster; the work is sent with every number, and waits in the scheduler's memory.
_IN_FLIGHT = 1024


class Work(Protocol):
    """What is to be done for each of many numbers."""

    def __call__(self, number: int) -> Any:
        """The result, which can be sent."""

    def identity(self) -> str:
        """A hash of what is computed, down to the program."""

    def parts(self) -> Mapping[str, Any]:
        """What it is made of, by the names that errors give them."""


def completed(
    work: Work, numbers: Iterable[int], executor: Executor | None
) -> Iterator[tuple[int, Any]]:
    """(number, work(number)) as they complete, in any order; None: here, one after the other.

    JAX settings that change numbers (precision, keys) are those of the caller wherever the work
    runs. Where it ends early, numbers that have not begun are cancelled.
    Raises ValueError for parts that cannot be sent to other processes, for processes made by fork,
    and for those that would run another program: with other versions, if on the same kind of
    device.
    """
    if executor is None:
        yield from ((i, work(i)) for i in numbers)
        return
    task = _task(work, executor)
    waiting, running = iter(numbers), {}
    try:
        while True:
            while len(running) < _IN_FLIGHT and (i := next(waiting, None)) is not None:
                running[executor.submit(*task, i)] = i
            if not running:
                return
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                yield running.pop(future), future.result()
    finally:
        for future in running:
            future.cancel()


def _task(work: Work, executor: Executor) -> tuple:
    """A function and its first arguments; the last is a number."""
    flags = {name: getattr(jax.config, name) for name in _FLAGS}
    if isinstance(executor, ThreadPoolExecutor):
        return _run, flags, work
    context = getattr(executor, "_mp_context", None)
    if context is not None and context.get_start_method() == "fork":
        raise ValueError(
            "the executor forks this process, in which JAX may hang: give ProcessPoolExecutor("
            "mp_context=multiprocessing.get_context('spawn'))"
        )
    for name, part in work.parts().items():
        try:
            dumps(part)
        except Exception as error:
            raise ValueError(
                f"{name} cannot be sent to another process ({error}): define it at the top of a "
                "module, or install cloudpickle"
            ) from error
    promised = jax.default_backend(), work.identity()
    return _run_sent, pickle.dumps((flags, promised, dumps(work)))


def _run(flags: dict[str, Any], work: Work, number: int) -> Any:
    with _under(flags):
        return work(number)


def _run_sent(content: bytes, number: int) -> Any:
    return _run(*_opened(content), number)


@functools.lru_cache(maxsize=1)
def _opened(content: bytes) -> tuple[dict[str, Any], Work]:
    """What was sent; once, for to `jax.jit` the functions of a second copy are new ones."""
    flags, (backend, identity), sent = pickle.loads(content)
    # Arrays of double precision are cut short where it is off.
    with _under(flags):
        work = pickle.loads(sent)
        if jax.default_backend() == backend and work.identity() != identity:
            raise ValueError(
                "a worker would run another program than this process: give it the same versions "
                "of posterior, JAX and your own modules"
            )
    return flags, work


def _under(flags: dict[str, Any]) -> ExitStack:
    stack = ExitStack()
    for name, value in flags.items():
        stack.enter_context(_FLAGS[name](value))
    return stack
