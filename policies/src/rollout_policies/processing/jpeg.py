"""The loss of a JPEG round trip, without creating the file.

Entropy coding is lossless, so the round trip consists of colour conversion, chroma subsampling, the
cosine transform and the rounding of its coefficients, and their inverses. Policies trained on RLDS
recordings, which are JPEGs, are evaluated on frames after such a round trip.

TensorFlow decodes with libjpeg's fast inverse transform, whose eight fractional bits change two
values in three by a level or more. Networks were trained on frames with these errors, so they are
reproduced here."""

from __future__ import annotations

import numpy as np

#: Pixels per side of a coding unit: two by two blocks of luma.
UNIT = 16
BLOCK = 8

#: ITU-T T.81, tables K.1 and K.2: quantisation of luma and of chroma at quality 50.
LUMA_STEPS = np.array(
    [
        [16, 11, 10, 16, 24, 40, 51, 61],
        [12, 12, 14, 19, 26, 58, 60, 55],
        [14, 13, 16, 24, 40, 57, 69, 56],
        [14, 17, 22, 29, 51, 87, 80, 62],
        [18, 22, 37, 56, 68, 109, 103, 77],
        [24, 35, 55, 64, 81, 104, 113, 92],
        [49, 64, 78, 87, 103, 121, 120, 101],
        [72, 92, 95, 98, 112, 100, 103, 99],
    ]
)
CHROMA_STEPS = np.full((BLOCK, BLOCK), 99)
CHROMA_STEPS[:4, :4] = [[17, 18, 24, 47], [18, 21, 26, 66], [24, 26, 56, 99], [47, 66, 99, 99]]

#: ITU-R BT.601, full range (JFIF), with sixteen fractional bits. The rows of the first matrix give
#: luma and the two chromas; those of the second give red, green and blue from the chromas, to be
#: added to luma.
COLOUR_BITS = 16
TO_LUMA_CHROMA = np.array([[19595, 38470, 7471], [-11059, -21709, 32768], [32768, -27439, -5329]])
#: Rounding bias of colours: halves round up in luma, down in chroma.
CHROMA_BIAS = np.array([0, -1, -1])
TO_RGB = np.array([[0, 91881], [-22554, -46802], [116130, 0]])
MIDDLE = 128

#: The slow forward transform of eight values: the root of 2 times cosines (1 in the first row),
#: with thirteen fractional bits. These are sums of Loeffler, Ligtenberg and
#: Moschytz's rounded multipliers, so some differ by one from the rounded product.
#: The second half of each row mirrors the first, with the opposite sign in odd rows.
SLOW_BITS = 13
SLOW_HALF = np.array(
    [
        [8192, 8192, 8192, 8192],
        [11363, 9633, 6437, 2260],
        [10703, 4433, -4433, -10703],
        [9633, -2259, -11362, -6436],
        [8192, -8192, -8192, 8192],
        [6437, -11362, 2261, 9633],
        [4433, -10704, 10704, -4433],
        [2260, -6436, 9633, -11363],
    ]
)
MIRROR = np.where(np.arange(BLOCK) % 2, -1, 1)[:, None]
#: The transform as floats, which NumPy multiplies faster than integers: all numbers are far below
#: 2^53, so the products are exact.
SLOW = np.hstack([SLOW_HALF, MIRROR * SLOW_HALF[:, ::-1]]).astype(np.float64)
#: Fractional bits kept between the row and column passes.
SLOW_SUM_BITS = 2

#: Arai, Agui and Nakajima's factors of the coefficients, in one dimension, and
#: the fractional bits of the sums of the fast inverse transform.
FAST_FACTORS = np.where(
    np.arange(BLOCK) == 0, 1.0, np.sqrt(2) * np.cos(np.pi / 16 * np.arange(BLOCK))
)
FAST_SUM_BITS = 2
#: Multipliers of the fast inverse transform, with eight fractional bits: the root of 2, twice the
#: cosine of 22.5 degrees, and the difference and the sum of twice the cosine and twice the sine of
#: that angle.
FAST_BITS = 8
ROOT_2, TWICE_COS, DIFFERENCE, SUM = 362, 473, 277, 669


def round_trip(frame: np.ndarray, quality: int = 95) -> np.ndarray:
    """Returns a frame, uint8 [height, width, 3], after a JPEG round trip.

    Equals `tf.io.decode_image(tf.image.encode_jpeg(frame))`: quality 95, chroma at half the
    resolution, the slow forward and the fast inverse transform.

    Raises ValueError if a side is not a multiple of 16."""
    height, width, _ = frame.shape
    if height % UNIT or width % UNIT:
        raise ValueError(f"a frame of {width}x{height} is not a multiple of {UNIT}x{UNIT} pixels")
    planes = _shift_right(frame @ TO_LUMA_CHROMA.T + CHROMA_BIAS, COLOUR_BITS)
    luma = _quantise(planes[..., 0] - MIDDLE, _quantisation_steps(LUMA_STEPS, quality))
    blue, red = (
        _upsample(
            _quantise(_subsample(planes[..., index]), _quantisation_steps(CHROMA_STEPS, quality))
        )
        for index in (1, 2)
    )
    tint = _shift_right(np.stack([blue, red], axis=-1) @ TO_RGB.T, COLOUR_BITS)
    return np.clip(luma[..., None] + MIDDLE + tint, 0, 255).astype(np.uint8)


def _quantisation_steps(table: np.ndarray, quality: int) -> np.ndarray:
    """Returns a quantisation table for a quality of 1..100, scaled by libjpeg's rule."""
    percent = 5000 // quality if quality < 50 else 200 - 2 * quality
    return np.clip((table * percent + 50) // 100, 1, 255)


def _subsample(plane: np.ndarray) -> np.ndarray:
    """Returns the means of two by two pixels; .5 is rounded down and up alternately."""
    height, width = plane.shape
    sums = plane.reshape(height // 2, 2, width // 2, 2).sum(axis=(1, 3))
    return (sums + 1 + np.arange(width // 2) % 2) // 4


def _quantise(plane: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Returns a plane, centred on 0, with its coefficients rounded to whole steps."""
    height, width = plane.shape
    blocks = plane.reshape(height // BLOCK, BLOCK, width // BLOCK, BLOCK).swapaxes(1, 2)
    eighths = _slow_forward(blocks)
    # Halves round away from zero.
    levels = np.sign(eighths) * ((np.abs(eighths) + 4 * steps) // (8 * steps))
    values = _fast_inverse(levels, steps)
    return np.clip(values.swapaxes(1, 2).reshape(height, width), -MIDDLE, MIDDLE - 1)


def _slow_forward(blocks: np.ndarray) -> np.ndarray:
    """Returns the coefficients of blocks [.., 8, 8], in eighths."""
    rows = _shift_right(blocks @ SLOW.T, SLOW_BITS - SLOW_SUM_BITS)
    return _shift_right(SLOW @ rows, SLOW_BITS + SLOW_SUM_BITS)


def _shift_right(values: np.ndarray, bits: int) -> np.ndarray:
    """Removes this many fractional bits, with halves rounded up."""
    return values.astype(np.int64) + (1 << (bits - 1)) >> bits


def _fast_inverse(levels: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Returns the pixels of blocks [.., 8, 8] from their coefficients' levels."""
    factors = np.round(2**14 * np.outer(FAST_FACTORS, FAST_FACTORS)).astype(np.int64)
    # The products of steps and factors, with two fractional bits.
    scaled_steps = (steps * factors + 2**11) >> (14 - FAST_SUM_BITS)
    columns = _fast_inverse_once((levels * scaled_steps).swapaxes(0, -2)).swapaxes(0, -2)
    rows = _fast_inverse_once(columns.swapaxes(0, -1)).swapaxes(0, -1)
    return rows >> (FAST_SUM_BITS + 3)


def _times(values: np.ndarray, multiplier: int) -> np.ndarray:
    return values * multiplier >> FAST_BITS


def _fast_inverse_once(c: np.ndarray) -> np.ndarray:
    """Returns eight values [8, ..] from eight scaled coefficients [8, ..]."""
    outer, inner = c[0] + c[4], c[0] - c[4]
    pair = c[2] + c[6]
    turned = _times(c[2] - c[6], ROOT_2) - pair
    even = [outer + pair, inner + turned, inner - turned, outer - pair]

    near, near_difference = c[5] + c[3], c[5] - c[3]
    far, far_difference = c[1] + c[7], c[1] - c[7]
    shared = _times(near_difference + far_difference, TWICE_COS)
    odd_0 = far + near
    odd_1 = shared + _times(near_difference, -SUM) - odd_0
    odd_2 = _times(far - near, ROOT_2) - odd_1
    odd_3 = -(_times(far_difference, DIFFERENCE) - shared + odd_2)
    odd = [odd_0, odd_1, odd_2, odd_3]
    first = [even[at] + odd[at] for at in range(4)]
    last = [even[at] - odd[at] for at in range(4)]
    return np.stack(first + last[::-1])


def _upsample(plane: np.ndarray) -> np.ndarray:
    """Doubles the size: each value is three quarters its own sample and one quarter the
    neighbour's, down and across, as in libjpeg's triangle filter."""
    sums = _doubled(_doubled(plane, axis=0), axis=1)
    return (sums + np.where(np.arange(sums.shape[1]) % 2, 7, 8)) // 16


def _doubled(values: np.ndarray, axis: int) -> np.ndarray:
    padded = np.pad(values, [(1, 1) if at == axis else (0, 0) for at in (0, 1)], mode="edge")
    before = padded.take(range(values.shape[axis]), axis)
    after = padded.take(range(2, values.shape[axis] + 2), axis)
    pair = np.stack([3 * values + before, 3 * values + after], axis=axis + 1)
    shape = list(values.shape)
    shape[axis] *= 2
    return pair.reshape(shape)
