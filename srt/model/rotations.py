"""Rotations as unit quaternions, their prefix products, and conversions to matrices and rotation vectors.

A unit quaternion w + xi + yj + zk is stored as two complex numbers, ``a = w - iz`` and ``b = -y - ix`` (the first
row of a matrix of SU(2)), in an array of shape (2, n). A product is then four complex multiplications of whole arrays.
Attitudes follow ``q_i = q_{i-1} ∘ dq_i``, with the body rotation on the right.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from srt.types import Array

    Quaternions = NDArray[np.complex128]

BESIDE = 2
"""Samples on either side from which the coning correction of a sample is taken."""
KINK = 0.1
"""Share of four successive differences that lies outside two neighbouring ones, from which on a rate has no kink. It is
0.17 and more where the rate is linear or quadratic, and zero at a kink between rest and rotation."""
TINY = 1e-300
"""Angle, rad, far below any other: it keeps a ratio of two zeros from being undefined."""
SMALL_ANGLE_SQUARED = 0.05
"""Squared rotation angle, rad², below which the Taylor series are exact to double precision."""


def from_rotation_vector(phi: Array) -> Quaternions:
    """Quaternions of rotation vectors of shape (3, n), rad; result (2, n)."""
    squared = np.einsum("in,in->n", phi, phi)
    if squared.size and squared.max() < SMALL_ANGLE_SQUARED:
        # Taylor series of cos(θ/2) and sin(θ/2)/θ in θ²; the first neglected terms, 8e-17 and 4e-18 at θ² = 0.05, are
        # below the rounding error.
        s = squared * 0.25
        cos_half = 1.0 - s * (1 / 2 - s * (1 / 24 - s * (1 / 720 - s / 40320)))
        sinc_half = 0.5 - s * (1 / 12 - s * (1 / 240 - s * (1 / 10080 - s / 725760)))
    else:
        angle = np.sqrt(squared)
        cos_half = np.cos(0.5 * angle)
        sinc_half = 0.5 * np.sinc(angle / (2.0 * np.pi))
    q = np.empty((2, phi.shape[1]), dtype=np.complex128)
    q.real[0] = cos_half
    negative = -sinc_half
    np.multiply(phi[2], negative, out=q.imag[0])
    np.multiply(phi[1], negative, out=q.real[1])
    np.multiply(phi[0], negative, out=q.imag[1])
    return q


def multiply(p: Quaternions, q: Quaternions) -> Quaternions:
    """Hamilton product p ∘ q of arrays of shape (2, n) (or broadcastable)."""
    # SU(2): (a, b)(c, d) = (a c - b d*, a d + b c*)
    out: Quaternions = p[0] * q
    crossed = p[1] * np.conj(q[::-1])
    out[0] -= crossed[0]
    out[1] += crossed[1]
    return out


def conjugate(q: Quaternions) -> Quaternions:
    """Inverse rotation."""
    return np.stack([np.conj(q[0]), -q[1]])


def prefix_product(q: Quaternions) -> Quaternions:
    """All partial products q_0 ∘ q_1 ∘ ... ∘ q_i of a chain, shape (2, n).

    Pairs are multiplied, the prefix products of the half-length chain follow by recursion, and the others from them:
    two products per element, all on whole arrays. Rounding errors grow with log n only.
    """
    n = q.shape[1]
    if n == 1:
        return q.copy()
    out = np.empty_like(q)
    pairs = prefix_product(multiply(q[:, 0 : n - 1 : 2], q[:, 1:n:2]))
    out[:, 0] = q[:, 0]
    out[:, 1::2] = pairs
    if n > 2:
        out[:, 2::2] = multiply(pairs[:, : (n - 1) // 2], q[:, 2::2])
    return out


def to_matrix(q: Quaternions) -> Array:
    """Direction cosine matrices, shape (3, 3, n), body to reference, normalised."""
    # Products of a = w - iz and b = -y - ix: Re a² = w² - z², Im a² = -2 wz, ..., two complex elements at a time.
    a, b = q
    aa, bb, ab = a * a, b * b, a * b
    mixed = np.conj(b)
    mixed *= a
    norm_a, norm_b = a.real**2 + a.imag**2, b.real**2 + b.imag**2
    C = np.empty((3, 3, q.shape[1]))
    np.subtract(aa.real, bb.real, out=C[0, 0])
    np.add(aa.imag, bb.imag, out=C[0, 1])
    np.multiply(ab.real, -2.0, out=C[0, 2])
    np.subtract(bb.imag, aa.imag, out=C[1, 0])
    np.add(aa.real, bb.real, out=C[1, 1])
    np.multiply(ab.imag, 2.0, out=C[1, 2])
    np.multiply(mixed.real, 2.0, out=C[2, 0])
    np.multiply(mixed.imag, 2.0, out=C[2, 1])
    np.subtract(norm_a, norm_b, out=C[2, 2])
    # Rounding changes the norm by about 1e-16 per level of the product tree; the division normalises it in one pass.
    norm_a += norm_b
    C /= norm_a
    return C


def rotation_matrix(phi: Array) -> Array:
    """Direction cosine matrices of rotation vectors of shape (..., 3): exp(φ×), shape (..., 3, 3)."""
    vectors = np.asarray(phi, dtype=np.float64)
    C = to_matrix(from_rotation_vector(np.ascontiguousarray(vectors.reshape(-1, 3).T)))
    return np.ascontiguousarray(np.moveaxis(C, 2, 0)).reshape(*vectors.shape[:-1], 3, 3)


def rotation_vector(C: Array) -> Array:
    """Rotation vectors of direction cosine matrices of shape (n, 3, 3), the inverse of :func:`rotation_matrix`; (n, 3).

    Exact to rounding for every angle up to π: the quaternion's largest element is found first, and divided by.
    """
    d = np.einsum("nii->ni", C)
    # Row i of four times the outer product of the quaternion (x, y, z, w) with itself, for each of its elements.
    outer = np.empty((len(C), 4, 4))
    outer[:, :3, :3] = C + np.swapaxes(C, 1, 2)
    trace = d.sum(axis=1)
    for i in range(3):
        outer[:, i, i] = 1.0 + 2.0 * d[:, i] - trace
    outer[:, 3, 3] = 1.0 + trace
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        outer[:, i, 3] = outer[:, 3, i] = C[:, k, j] - C[:, j, k]
    row = np.argmax(np.einsum("nii->ni", outer), axis=1)
    q = outer[np.arange(len(C)), row]
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    q[q[:, 3] < 0.0] *= -1.0
    sine = np.linalg.norm(q[:, :3], axis=1)
    angle = 2.0 * np.arctan2(sine, q[:, 3])
    factor = np.where(sine > 1e-8, angle / np.maximum(sine, 1e-300), 2.0)
    return np.asarray(q[:, :3] * factor[:, None])


def inverse_right_jacobian(phi: Array) -> Array:
    """Jr⁻¹ of rotation vectors of shape (n, 3): Log(exp(φ×) exp(δ×)) = φ + Jr⁻¹ δ; shape (n, 3, 3).

    The left one, for a rotation in front, is its transpose.
    """
    squared = np.einsum("na,na->n", phi, phi)
    angle = np.sqrt(squared)
    half = 0.5 * np.where(angle > 1e-3, angle, 1.0)
    exact = (1.0 - half / np.tan(half)) / (4.0 * half * half)
    factor = np.where(angle > 1e-3, exact, 1.0 / 12.0 + squared / 720.0)
    X = cross_matrix(phi)
    return np.asarray(np.eye(3) + 0.5 * X + factor[:, None, None] * (X @ X))


def smallest_rotation(before: Array, after: Array) -> Array:
    """Matrices of the smallest rotations that take unit vectors ``before`` to ``after``, (..., 3) each; (..., 3, 3)."""
    X = cross_matrix(np.cross(before, after))
    cosine = np.einsum("...a,...a->...", before, after)
    return np.asarray(np.eye(3) + X + X @ X / np.maximum(1.0 + cosine, 1e-6)[..., None, None])


def cross_matrix(v: Array) -> Array:
    """Skew matrix (v×) of vectors of shape (..., 3); shape (..., 3, 3)."""
    out = np.zeros((*v.shape, 3))
    out[..., 0, 1], out[..., 0, 2] = -v[..., 2], v[..., 1]
    out[..., 1, 0], out[..., 1, 2] = v[..., 2], -v[..., 0]
    out[..., 2, 0], out[..., 2, 1] = -v[..., 1], v[..., 0]
    return out
