"""A folder of pictures that show no hand, for `torchhand measure_status --without`: crops of photographs that come with
packages (scikit-image, scikit-learn, Matplotlib, imgaug, insightface, ultralytics, face_recognition), of what is around
the hands in photographs with masks, and drawn pictures. Nothing is fetched: give the packages' archives.

    python scripts/empty_pictures.py OUT --archives FOLDER [--hands FOLDER] [--count 1000] [--seed 0]

Names are KIND_SOURCE_NUMBER.png; all crops of a picture have its SOURCE, so that sources can be held out.
"""

import argparse
import io
import sys
import tarfile
import zipfile
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

sys.path[0] = str(Path(__file__).resolve().parents[1])
from torchhand.study.status import drawn_pictures  # noqa: E402

LONG_SIDE = 320
ASPECTS = (4 / 3, 1.0, 3 / 4)
# Regions without a hand: (left, top, right, bottom) in shares of the width and height, looked at one by one.
WHOLE = ((0.0, 0.0, 1.0, 1.0),)
REGIONS = {
    "face": {
        "astronaut.png": WHOLE,
        "grace_hopper.jpg": WHOLE,
        "biden.jpg": ((0, 0, 1, 0.42),),
        "obama.jpg": ((0, 0, 1, 0.6),),
        "obama2.jpg": WHOLE,
        "obama3.jpg": ((0, 0, 1, 0.42),),
        "obama_partial_face.jpg": ((0, 0, 1, 0.62),),
        "obama_partial_face2.jpg": ((0, 0, 1, 0.62),),
        "t1.jpg": (
            (0.67, 0, 0.85, 0.26),
            (0.2, 0.11, 0.36, 0.29),
            (0.02, 0.25, 0.16, 0.42),
            (0.36, 0.24, 0.48, 0.45),
            (0.58, 0.32, 0.69, 0.53),
            (0.87, 0.26, 0.99, 0.49),
        ),
        "zidane.jpg": ((0.37, 0.25, 0.52, 0.63), (0.7, 0.02, 0.84, 0.43)),
    },
    "thing": {
        "chelsea.png": WHOLE,
        "coffee.png": WHOLE,
        "flower.jpg": WHOLE,
        "china.jpg": WHOLE,
        "rocket.jpg": WHOLE,
        "motorcycle_left.png": WHOLE,
        "ihc.png": WHOLE,
        "retina.jpg": WHOLE,
        "quokka.jpg": ((0, 0, 1, 0.55),),
        "mask_black.jpg": WHOLE,
        "mask_blue.jpg": WHOLE,
        "mask_green.jpg": WHOLE,
    },
}


def pictures_of(archives: Path) -> Iterator[tuple[str, str, np.ndarray]]:
    """Kind, source and region of every picture that stands in REGIONS."""
    for path in sorted(archives.iterdir()):
        if path.suffix == ".whl":
            with zipfile.ZipFile(path) as wheel:
                files = {name: wheel.read(name) for name in wheel.namelist() if _is_wanted(name)}
        elif path.name.endswith(".tar.gz"):
            with tarfile.open(path) as source:
                members = [one for one in source.getmembers() if one.isfile() and _is_wanted(one.name)]
                files = {one.name: (source.extractfile(one) or io.BytesIO()).read() for one in members}
        else:
            continue
        for name, content in sorted(files.items()):
            image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)
            if image is None:
                continue
            base = name.rpartition("/")[2]
            for kind, regions in REGIONS.items():
                for number, (left, top, right, bottom) in enumerate(regions.get(base, ())):
                    height, width = image.shape[:2]
                    part = image[
                        round(top * height) : round(bottom * height), round(left * width) : round(right * width)
                    ]
                    yield kind, f"{Path(base).stem.replace('_', '-')}-{number}", part


def _is_wanted(name: str) -> bool:
    return "baseline" not in name and any(name.rpartition("/")[2] in regions for regions in REGIONS.values())


def crop(image: np.ndarray, chance: np.random.Generator) -> tuple[int, int, int, int]:
    """Left, top, width, height of a random part, a third of the picture or more in one direction."""
    height, width = image.shape[:2]
    aspect = ASPECTS[int(chance.integers(len(ASPECTS)))]
    wide = min(width, height * aspect) * chance.uniform(0.35, 1)
    size = max(1, round(wide)), max(1, round(wide / aspect))
    return int(chance.integers(width - size[0] + 1)), int(chance.integers(height - size[1] + 1)), *size


def photographed(image: np.ndarray, box: tuple[int, int, int, int], chance: np.random.Generator) -> np.ndarray:
    """A part, at the size of the set, perhaps mirrored."""
    left, top, width, height = box
    part = image[top : top + height, left : left + width]
    scale = LONG_SIDE / max(width, height)
    method = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    size = max(1, round(scale * width)), max(1, round(scale * height))
    part = cv2.resize(part, size, interpolation=method)
    return part[:, ::-1] if chance.random() < 0.5 else part


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--archives", type=Path, required=True)
    parser.add_argument("--hands", type=Path)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    chance = np.random.default_rng(given.seed)
    photographs = list(pictures_of(given.archives))
    rooms = [] if given.hands is None else list(surroundings(given.hands, chance))[: given.count // 8]
    share = 0 if not photographs else (given.count // 2 - len(rooms)) // len(photographs)
    for kind, source, image in photographs:
        for number in range(share):
            save(given.out, f"{kind}_{source}_{number}", photographed(image, crop(image, chance), chance))
    for source, image in rooms:
        save(given.out, f"room_{source}_0", image)
    rest = given.count - share * len(photographs) - len(rooms)
    for number, (kind, picture) in enumerate(drawn_pictures(rest, given.seed)):
        save(given.out, f"drawn-{kind}_seed{given.seed}_{number}", cv2.cvtColor(picture.numpy(), cv2.COLOR_RGB2BGR))
    print(f"{rest} drawn, {share * len(photographs)} crops of {len(photographs)} regions, {len(rooms)} of surroundings")


def surroundings(hands: Path, chance: np.random.Generator) -> Iterator[tuple[str, np.ndarray]]:
    """Parts of photographs that hold nothing of the skin that their masks tell of."""
    for path in sorted(hands.iterdir()):
        mask_path = path.with_name(f"{path.stem}_mask.png")
        if path.stem.endswith("_mask") or not mask_path.is_file():
            continue
        image, mask = cv2.imread(str(path)), cv2.imread(str(mask_path), cv2.IMREAD_GRAYSCALE)
        if image is None or mask is None:
            continue
        skin = cv2.dilate((mask > 127).astype(np.uint8), np.ones((15, 15), np.uint8))
        for _ in range(50):
            left, top, width, height = box = crop(image, chance)
            if min(width, height) >= 110 and not skin[top : top + height, left : left + width].any():
                yield path.stem.replace("_", "-"), photographed(image, box, chance)
                break


def save(folder: Path, name: str, image: np.ndarray) -> None:
    cv2.imwrite(str(folder / f"{name}.png"), image)


if __name__ == "__main__":
    main()
