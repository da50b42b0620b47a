"""Datasets: one format a file, each read into observations."""

from mixer_torch.datasets.base import Dataset
from mixer_torch.datasets.coco import COCO
from mixer_torch.datasets.crowd import Crowd
from mixer_torch.datasets.landmarks import Landmarks
from mixer_torch.datasets.motchallenge import MOTChallenge
from mixer_torch.datasets.multicamera import MultiCamera
from mixer_torch.datasets.parking_lot import ParkingLot
from mixer_torch.datasets.persons import Persons
from mixer_torch.datasets.table import Table

__all__ = [
    "COCO",
    "Crowd",
    "Dataset",
    "Landmarks",
    "MOTChallenge",
    "MultiCamera",
    "ParkingLot",
    "Persons",
    "Table",
]
