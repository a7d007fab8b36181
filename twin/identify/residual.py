"""How FRFs are compared: the weighted residual, and the robust one of their logarithms, with what pulls on parameters.

Linear: ½ Σ |H − H(z)|²/(σ² + (temper |H|)²), right near the optimum. Logarithmic: Cauchy's robust sum of squares
½ Σ ln(1 + |ln(H/H(z))|²/(spread² + σ²/|H|²)): as far as it bends, a peak pulls from anywhere.
"""

import numpy as np

from twin.measure.campaign import ComplexArray, FloatArray

LOG_SPREAD = 0.3  # neper and rad: scale of the robust logarithmic residual


def weights(frf: ComplexArray, variance: FloatArray, temper: float = 0.0, logarithmic: bool = False) -> FloatArray:
    """1/σ of every line; zero where it is not used (infinite variance, or no logarithm)."""
    size = np.abs(frf) ** 2
    if not logarithmic:
        return np.asarray(1 / np.sqrt(variance + temper**2 * size))
    relative = np.divide(variance, size, out=np.full(size.shape, np.inf), where=size > 0)
    return np.asarray(1 / np.sqrt(LOG_SPREAD**2 + relative))


def loss(frf: ComplexArray, H: ComplexArray, weight: FloatArray, logarithmic: bool, repeat: float = 1.0) -> float:
    """The sum; with logarithms, each line stands for ``repeat`` lines, whose root is in the weight."""
    if logarithmic:
        return _robust(_squares(*_ratio(frf, H), weight, repeat), repeat)
    e = (frf - H) * weight
    return 0.5 * float(np.sum(e.real**2 + e.imag**2))


def pull(
    frf: ComplexArray, H: ComplexArray, weight: FloatArray, logarithmic: bool, repeat: float = 1.0
) -> tuple[float, ComplexArray, ComplexArray | FloatArray]:
    """The sum, the residual as it pulls on parameters (reweighted, where robust), and its derivative ∂/∂H."""
    if not logarithmic:
        e = np.asarray((frf - H) * weight, complex)
        return 0.5 * float(np.sum(e.real**2 + e.imag**2)), e, -weight
    size, turn = _ratio(frf, H)
    squares = _squares(size, turn, weight, repeat)
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = np.where(H != 0, -1 / H, 0)
    weight = weight / np.sqrt(1 + squares)  # iteratively reweighted: slope of the robust sum
    return _robust(squares, repeat), np.asarray((size + 1j * turn) * weight), np.asarray(inverse * weight)


def _ratio(frf: ComplexArray, H: ComplexArray) -> tuple[FloatArray, FloatArray]:
    """ln(H/H(z)) as its real and imaginary part, apart: numpy's complex logarithm is seven times slower."""
    ratio = np.divide(frf, H, out=np.ones_like(H), where=(H != 0) & (frf != 0))
    with np.errstate(divide="ignore", over="ignore"):
        return 0.5 * np.log(ratio.real**2 + ratio.imag**2), np.arctan2(ratio.imag, ratio.real)


def _squares(size: FloatArray, turn: FloatArray, weight: FloatArray, repeat: float) -> FloatArray:
    return np.asarray((size**2 + turn**2) * (weight**2 / repeat))


def _robust(squares: FloatArray, repeat: float) -> float:
    return 0.5 * repeat * float(np.sum(np.log1p(squares)))
