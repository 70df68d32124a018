"""The settings of a classifier's data, and the defaults of each data set."""

from dataclasses import dataclass

from omegaconf import MISSING

from training.config.settings import setting

AUGMENTATIONS = ("none", "shift", "shift_flip", "affine")
TORCHVISION_SETS = ("cifar10", "cifar100", "gtsrb")  # data sets that torchvision reads


@dataclass
class Data:
    """The images, their size and their numbers."""

    name: str = setting(MISSING, "the data set", choices=("signs", *TORCHVISION_SETS, "folder"))
    root: str | None = setting(
        None,
        "the data's folder; data=folder: with train/ and test/, or class folders alone, then all "
        "test data",
        is_path=True,
        only_for=("folder", *TORCHVISION_SETS),
        may_differ=True,
    )
    size: int = setting(
        64, "side of the images, in pixels; the lens blurs small ones more", bounds=(16, 8192)
    )
    train: int | None = setting(None, "training images; null is all there are", bounds=(1, None))
    val: int | None = setting(
        None, "validation images; null is 10 % of the training images", bounds=(1, None)
    )
    test: int | None = setting(
        None, "test images; null is all there are", bounds=(1, None), tests=True
    )
    class_index: str | None = setting(
        None,
        "CSV of folder (or wnid) and class_index among the 1000 of published weights",
        is_path=True,
        only_for=("folder",),
    )
    augment: str = setting(
        "none",
        "of clean training images: none, shift (by up to 12.5 %), shift_flip, or affine (small "
        "changes of place, form and tone, and erased parts)",
        choices=AUGMENTATIONS,
        trains=True,
    )
    workers: int = setting(
        0,
        "processes that read images",
        bounds=(0, 1024),
        changes_result=False,
        may_differ=True,
        from_run=False,
    )
    download: bool = setting(
        False,
        "whether to fetch a published data set",
        changes_result=False,
        may_differ=True,
        from_run=False,
        only_for=TORCHVISION_SETS,
    )


DATA = {
    "signs": Data(name="signs", size=48, train=12000, val=320, test=1600),
    "cifar10": Data(name="cifar10", root="data", augment="shift_flip"),
    "cifar100": Data(name="cifar100", root="data", augment="shift_flip"),
    "gtsrb": Data(name="gtsrb", root="data", augment="affine"),
    "folder": Data(name="folder", augment="shift"),
}


DEFAULT_DATA = "signs"
EPOCHS = {"signs": 5}  # of a classifier's training, where `Train` says otherwise
