"""SSIM and PSNR of scikit-image, gradient norms of numpy on Pillow's luma, and S3 written out from
its paper (Vu, Phan, Chandler 2012), pixel by pixel.

usage: metric_peers.py A.png B.png
Prints one JSON object.
"""

import json
import sys

import numpy as np
from PIL import Image
from skimage.metrics import peak_signal_noise_ratio, structural_similarity


def luma(rgb):
    return np.array(Image.fromarray(rgb).convert("L")).astype(np.float64)


def gradient_norm(rgb):
    down, right = np.gradient(luma(rgb))
    return np.hypot(down, right)


def has_contrast(block):
    light = (0.7656 + 0.0364 * block) ** 2.2
    for row in range(0, 25, 4):
        for column in range(0, 25, 4):
            part = light[row : row + 8, column : column + 8]
            mean = part.mean()
            if mean > 127.5:
                mean = 255 - mean
            if mean > 2 and part.max() - part.min() > 5:
                return True
    return False


def slope(block):
    hann = np.hanning(34)[1:-1]
    spectrum = np.abs(np.fft.fft2(block * np.outer(hann, hann)))
    spectrum[0, 0] = (spectrum[0, 1] + spectrum[1, 0]) / 2
    angles = np.arange(360) * np.pi / 180
    logs = []
    for radius in range(1, 17):
        x, y = radius * np.cos(angles), radius * np.sin(angles)
        # Away from whole numbers' noise, so that rounding does not choose the cell.
        x, y = np.round(x, 12), np.round(y, 12)
        x0, y0 = np.floor(x).astype(int), np.floor(y).astype(int)
        fx, fy = x - x0, y - y0
        at = lambda dx, dy: spectrum[(y0 + dy) % 32, (x0 + dx) % 32]
        mean = (
            (1 - fx) * (1 - fy) * at(0, 0)
            + fx * (1 - fy) * at(1, 0)
            + (1 - fx) * fy * at(0, 1)
            + fx * fy * at(1, 1)
        ).mean()
        logs.append(np.log(mean))
    return -np.polyfit(np.log(np.arange(1, 17) / 32), logs, 1)[0]


def spectral(image):
    height, width = image.shape
    padded = np.pad(image, 40, mode="symmetric")
    sharpness = {}
    out = np.zeros_like(image)
    for y in range(height):
        for x in range(width):
            centre = ((y + 4) // 8 * 8, (x + 4) // 8 * 8)
            if centre not in sharpness:
                top, left = centre[0] - 16 + 40, centre[1] - 16 + 40
                block = padded[top : top + 32, left : left + 32]
                alpha = slope(block) if has_contrast(block) else np.inf
                sharpness[centre] = 1 - 1 / (1 + np.exp(-3 * (alpha - 2)))
            out[y, x] = sharpness[centre]
    return out


def variation(image, shift):
    height, width = image.shape
    padded = np.pad(image, 16, mode="symmetric")
    out = np.zeros_like(image)
    for top in range(-shift, height, 8):
        for left in range(-shift, width, 8):
            block = padded[top + 16 : top + 24, left + 16 : left + 24]
            best = 0
            for i in range(7):
                for j in range(7):
                    four = block[i : i + 2, j : j + 2].ravel()
                    pairs = [abs(four[a] - four[b]) for a in range(4) for b in range(a)]
                    best = max(best, sum(pairs) / 255 / 4)
            out[max(top, 0) : top + 8, max(left, 0) : left + 8] = best
    return out


def s3(rgb):
    image = luma(rgb)
    spatial = np.maximum(variation(image, 0), variation(image, 4))
    return np.sqrt(spectral(image) * spatial)


a, b = (np.array(Image.open(path).convert("RGB")) for path in sys.argv[1:3])
print(
    json.dumps(
        {
            "psnr": peak_signal_noise_ratio(a, b, data_range=255),
            "ssim_gaussian": structural_similarity(
                a,
                b,
                channel_axis=2,
                data_range=255,
                gaussian_weights=True,
                sigma=1.5,
                use_sample_covariance=False,
            ),
            "ssim_uniform": structural_similarity(a, b, channel_axis=2, data_range=255),
            "grad": np.abs(gradient_norm(a) - gradient_norm(b)).mean(),
            "s3": s3(a).ravel().tolist(),
        }
    )
)
