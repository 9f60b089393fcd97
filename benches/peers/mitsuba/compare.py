#!/usr/bin/env python3
"""Renders the same scenes with this library and with Mitsuba 3, and fails where they differ by more than their noise.

    python3 -m venv /tmp/mitsuba && /tmp/mitsuba/bin/pip install mitsuba numpy
    cargo run --release --features scene-file,exr --example render -- --help     (builds it)
    /tmp/mitsuba/bin/python benches/peers/mitsuba/compare.py [SCENE]...

Each renderer makes `--pictures` pictures of a scene with different seeds. Per block of pixels and channel, z is the difference of the two
means over its standard error, which the spread of the pictures gives (Welch). Without a difference z has about a standard normal's
distribution. A scene fails if any of these is out of its limit: the largest |z|, the share of |z| above 3, the root mean square of z, and
|z| of the whole picture. All seeds are fixed.

Status 0: no difference was found; 1: one was; 2: something is missing.
"""

import argparse
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]

# With 32 pictures each, t has some 60 degrees of freedom: |t| > 5.5 has a chance of 8e-7, times 768 values per scene.
LARGEST = 5.5
# 0.39 % are expected; channels of a block, and what a bright path adds to its block, go together.
SHARE_ABOVE_3 = 0.02
# 1.02 is expected, with a standard deviation of about 0.03 over 256 blocks of channels that go together.
RMS = 1.2
WHOLE = 4.5


def missing(what):
    print(what, file=sys.stderr)
    sys.exit(2)


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", metavar="SCENE", help="all of them if none is given")
    parser.add_argument("--render", type=Path, default=ROOT / "target/release/examples/render")
    parser.add_argument("--variant", default="llvm_ad_rgb", help="of Mitsuba")
    parser.add_argument("--size", type=int, default=128, help="of the pictures; a multiple of the block's")
    parser.add_argument("--block", type=int, default=8, help="side of a block in pixels")
    parser.add_argument("--samples", type=int, default=32, help="per pixel and picture")
    parser.add_argument("--pictures", type=int, default=32, help="per renderer and scene, at least 8")
    parser.add_argument("--factor", type=float, default=1.0, help="multiply diffuse reflectances here, not in Mitsuba")
    parser.add_argument("--keep", type=Path, help="write means and z of each scene there, as .exr")
    return parser.parse_args()


def main():
    options = arguments()
    try:
        import numpy as np
        import mitsuba as mi
        import drjit as dr
    except ImportError as error:
        missing(f"{error}: `pip install mitsuba numpy` into an environment of its own, and use that environment's python")
    if not options.render.is_file():
        missing(
            f"{options.render} is not there: `cargo build --release --features scene-file,exr --example render`,"
            " or name it with --render"
        )
    if options.size % options.block or options.pictures < 8:
        missing("--size must be a multiple of --block, and --pictures at least 8")
    try:
        mi.set_variant(options.variant)
    except (ImportError, RuntimeError, AttributeError) as error:
        missing(f"the variant {options.variant} does not work here ({error}); variants: {', '.join(mi.variants())}")
    import ours
    import theirs
    from scenes import SCENES, with_diffuse_times

    unknown = set(options.scenes) - set(SCENES)
    if unknown:
        missing(f"no scene {', '.join(sorted(unknown))}; there are {', '.join(SCENES)}")
    theirs.correlated_bsdf(mi, dr)

    def blocks(picture):
        n = options.size // options.block
        return picture.reshape(n, options.block, n, options.block, 3).mean((1, 3))

    print(f"Mitsuba {mi.__version__} {options.variant}; {options.pictures} pictures of {options.size} x {options.size} pixels,"
          f" {options.samples} samples, per renderer; blocks of {options.block} x {options.block}")
    print("| scene | mean here | mean there | difference | its standard error | largest z | above 3 | rms z | |")
    print("|---|---|---|---|---|---|---|---|---|", flush=True)
    failed = False
    for name in options.scenes or SCENES:
        scene = SCENES[name]()
        with tempfile.TemporaryDirectory() as folder:
            folder = Path(folder)
            seeds = range(1, options.pictures + 1)
            changed = with_diffuse_times(scene, options.factor) if options.factor != 1.0 else scene
            sides = [
                ours.pictures(changed, folder, options.render, options.size, options.samples, seeds, mi.Bitmap),
                theirs.pictures(mi, scene, folder, options.size, options.samples, seeds),
            ]
            sides = [np.array(list(side)) for side in sides]
        if not all(np.isfinite(side).all() for side in sides):
            print(f"| {name} | a value that is not finite | **FAILS** |")
            failed = True
            continue

        def z_of(values):
            (a, b), (va, vb) = ([f(v) for v in values] for f in (lambda v: v.mean(0), lambda v: v.var(0, ddof=1)))
            error = np.sqrt((va + vb) / options.pictures)
            # Blocks that no noise reaches (a background of one colour) are compared by rounding.
            return (a - b) / np.maximum(error, 1e-6 * (np.abs(a) + np.abs(b)) + 1e-12), error

        z, _ = z_of([np.array([blocks(picture) for picture in side]) for side in sides])
        whole, error = z_of([side.mean((1, 2)) for side in sides])
        gray, gray_error = z_of([side.mean((1, 2, 3)) for side in sides])
        means = [side.mean() for side in sides]
        largest, share = np.abs(z).max(), (np.abs(z) > 3).mean()
        rms = np.sqrt((z**2).mean())
        is_wrong = largest > LARGEST or share > SHARE_ABOVE_3 or rms > RMS or max(np.abs(whole).max(), abs(gray)) > WHOLE
        failed |= bool(is_wrong)
        print(
            f"| {name} | {means[0]:.5f} | {means[1]:.5f} | {100 * (means[0] / means[1] - 1):+.3f} % |"
            f" {100 * gray_error / means[1]:.3f} % | {largest:.2f} | {100 * share:.2f} % | {rms:.3f} |"
            f" {'**FAILS**' if is_wrong else 'within noise'} |",
            flush=True,
        )
        if options.keep:
            options.keep.mkdir(parents=True, exist_ok=True)
            kept = {"ours": sides[0].mean(0), "theirs": sides[1].mean(0), "z": z}
            for what, picture in kept.items():
                mi.Bitmap(np.ascontiguousarray(picture.astype(np.float32))).write(str(options.keep / f"{name}-{what}.exr"))
                png = mi.Bitmap(np.ascontiguousarray(picture.astype(np.float32)))
                png.convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.UInt8, True).write(
                    str(options.keep / f"{name}-{what}.png")
                )
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
