"""Comparing shapes and functions: MAC, MPC, FRAC; indicator functions that show where modes are."""

import numpy as np

from twin.measure.campaign import ComplexArray, FloatArray


def mac(a: ComplexArray | FloatArray, b: ComplexArray | FloatArray | None = None) -> FloatArray:
    """Modal assurance criterion (na, nb) between shapes in rows (Allemang & Brown 1982); auto-MAC without ``b``."""
    b = a if b is None else b
    cross = np.abs(a.conj() @ b.T) ** 2
    size = np.sum(np.abs(a) ** 2, axis=1)[:, None] * np.sum(np.abs(b) ** 2, axis=1)
    return np.asarray(np.divide(cross, size, out=np.zeros_like(cross), where=size > 0))


def mpc(shape: ComplexArray) -> FloatArray:
    """Modal phase collinearity (n,) of shapes in rows: 1 for a real mode at any phase (Pappa et al. 1993)."""
    re, im = shape.real, shape.imag
    xx, yy, xy = np.sum(re * re, axis=1), np.sum(im * im, axis=1), np.sum(re * im, axis=1)
    size = xx + yy
    return np.asarray(np.divide((xx - yy) ** 2 + 4 * xy**2, size**2, out=np.zeros_like(size), where=size > 0))


def real_phase(shape: ComplexArray) -> ComplexArray:
    """Shapes in rows turned to the phase that makes them most real, largest entry +1."""
    turn = np.exp(-0.5j * np.angle(np.sum(shape**2, axis=1, keepdims=True)))
    turned = shape * turn
    largest = np.take_along_axis(turned, np.argmax(np.abs(turned), axis=1)[:, None], axis=1)
    scale = np.abs(largest) * np.where(largest.real < 0, -1, 1)
    return np.asarray(turned / np.where(scale == 0, 1, scale))


def frac(measured: ComplexArray, synthesised: ComplexArray) -> FloatArray:
    """Frequency response assurance criterion (…) over the first axis of two FRF sets (Heylen & Lammens 1996)."""
    cross = np.abs(np.sum(measured * synthesised.conj(), axis=0)) ** 2
    size = np.sum(np.abs(measured) ** 2, axis=0) * np.sum(np.abs(synthesised) ** 2, axis=0)
    return np.asarray(np.divide(cross, size, out=np.zeros_like(cross), where=size > 0))


def summation(frf: ComplexArray) -> FloatArray:
    """(nf,) sum of the magnitudes of all FRFs (nf, no, ni)."""
    return np.sum(np.abs(frf), axis=(1, 2))


def cmif(frf: ComplexArray) -> FloatArray:
    """(nf, min(no, ni)) complex mode indicator functions: singular values per line (Shih et al. 1988)."""
    return np.asarray(np.linalg.svd(frf, compute_uv=False))


def mode_indicator(frf: ComplexArray) -> FloatArray:
    """(nf,) normal mode indicator of accelerance or receptance: towards 0 where all responses are in quadrature."""
    size = np.abs(frf)
    total = np.sum(size**2, axis=(1, 2))
    return np.asarray(np.divide(np.sum(np.abs(frf.real) * size, axis=(1, 2)), total, where=total > 0, out=total * 0))
