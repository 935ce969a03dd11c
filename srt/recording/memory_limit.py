"""Limits of the memory of a process, under which some libraries end it or wait for ever."""

from __future__ import annotations


def require_memory(size: int) -> None:
    """Require memory, bytes, for a library that ends badly without it, if the system limits that of the process.

    Raises MemoryError.
    """
    if memory_is_limited():
        bytearray(size)


def memory_is_limited() -> bool:
    """True if the system limits the memory of this process."""
    try:
        import resource
    except ModuleNotFoundError:  # no such limits on this system
        return False
    kinds = resource.RLIMIT_DATA, resource.RLIMIT_AS
    return any(resource.getrlimit(kind)[0] != resource.RLIM_INFINITY for kind in kinds)
