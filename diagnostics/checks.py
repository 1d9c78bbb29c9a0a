"""What is refused of draws and truths, alike in every statistic and in one sentence each."""

import numpy as np

DIVERGED = "the run has diverged, give the sampler a smaller step"


def check_finite(name: str, array: np.ndarray, remedy: str = DIVERGED) -> None:
    """Refuse NaN and infinity, and say how many they are."""
    lost = array.size - np.count_nonzero(np.isfinite(array))
    if lost:
        raise ValueError(f"{lost} of {array.size} values of the {name} are not finite: {remedy}")


def check_draws_finite(draws: np.ndarray, name: str = "draws", remedy: str = DIVERGED) -> None:
    """Refuse draws (n, *shape) with NaN or infinity in them, and say how many of them."""
    lost = int(np.sum(~np.isfinite(draws.reshape(len(draws), -1)).all(axis=1)))
    if lost:
        raise ValueError(f"{lost} of {len(draws)} {name} are not finite: {remedy}")


def check_real(**arrays: np.ndarray) -> None:
    """Refuse complex arrays, given by name: of a real statistic the imaginary part is no part."""
    for name, array in arrays.items():
        if np.iscomplexobj(array):
            raise ValueError(f"complex {name}: give abs(), .real or .imag of them, one at a time")


def check_kinds(name: str, array: np.ndarray, other_name: str, other: np.ndarray) -> None:
    """Refuse a complex array beside a real one."""
    if np.iscomplexobj(array) != np.iscomplexobj(other):
        raise ValueError(
            f"{name} of {array.dtype} beside {other_name} of {other.dtype}: give both real, or "
            "both complex"
        )


def check_beside(truths: np.ndarray, draws: np.ndarray, real: bool = True, fewest: int = 1) -> None:
    """Refuse draws (n, L, ...) and truths (n, ...) that do not fit, or are not finite.

    `fewest`: draws that are needed of each. Complex ones are refused if `real`, else one of them
    complex beside the other real.
    """
    if real:
        check_real(truths=truths, draws=draws)
    else:
        check_kinds("draws", draws, "truths", truths)
    if draws.ndim < 2 or draws.shape[:1] + draws.shape[2:] != truths.shape or not truths.size:
        raise ValueError(
            f"draws of shape {draws.shape} for truths of {truths.shape}: give (n, draws, ...) and "
            "(n, ...)"
        )
    if draws.shape[1] < fewest:
        raise ValueError(f"{draws.shape[1]} draws of each truth: give {fewest} or more")
    check_finite("truths", truths, "leave out those that hold them")
    check_finite("draws", draws)


def check_varies(draws: np.ndarray, axis: int) -> None:
    """Refuse draws that are all the same along the axis they are counted on."""
    if not varies(draws, axis):
        raise ValueError(
            f"the {draws.shape[axis]} draws do not vary, the chains have not moved or one draw is "
            "given several times: run them longer or with another step"
        )


def varies(draws: np.ndarray, axis: int) -> bool:
    """Whether any value differs between draws."""
    return bool(np.any(draws != np.take(draws, [0], axis)))


def check_level(level: float, name: str = "level") -> None:
    """Refuse shares that are not between 0 and 1."""
    if not 0 < level < 1:
        raise ValueError(f"{name} {level}: it must lie between 0 and 1")
