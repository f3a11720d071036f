"""What a reader of a result needs to know about a dataset, as validated data."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

GroundTruth = Literal["dense", "sparse", "none"]


class DatasetMetadata(BaseModel):
    """A dataset in words.

    Attributes:
        name: the registered name.
        title: what its authors call it.
        description: one sentence.
        ground_truth: "dense", "sparse" (a laser scanner, some pixels) or "none".
        licence: the terms its distributors state; check them before use.
        citation: authors, title, venue, year.
        layout: the folders its root must hold.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str = Field(pattern=r"^[a-z][a-z0-9_]*$")
    title: str = Field(min_length=1)
    description: str = Field(min_length=1)
    ground_truth: GroundTruth
    licence: str = Field(min_length=1)
    citation: str = Field(min_length=1)
    layout: str = Field(min_length=1)


_NON_COMMERCIAL = "non-commercial research only, see the distributor's terms"

METADATA: dict[str, DatasetMetadata] = {
    entry.name: entry
    for entry in (
        DatasetMetadata(
            name="motorcycle",
            title="Middlebury 2014 Motorcycle",
            description="One real stereo pair, 741x500, which scikit-image ships; flow is minus its disparity.",
            ground_truth="dense",
            licence="distributed with scikit-image; see its notice on the Middlebury stereo data",
            citation="Scharstein et al., High-Resolution Stereo Datasets with Subpixel-Accurate Ground Truth, 2014",
            layout="no root needed",
        ),
        DatasetMetadata(
            name="kitti2015",
            title="KITTI flow 2015",
            description="200 training pairs of driving with moving cars, about 1242x375.",
            ground_truth="sparse",
            licence="CC BY-NC-SA 3.0",
            citation="Menze and Geiger, Object Scene Flow for Autonomous Vehicles, CVPR 2015",
            layout="training/image_2, training/flow_occ, training/flow_noc",
        ),
        DatasetMetadata(
            name="kitti2012",
            title="KITTI flow 2012",
            description="194 training pairs of driving through a static world, about 1242x375.",
            ground_truth="sparse",
            licence="CC BY-NC-SA 3.0",
            citation="Geiger, Lenz and Urtasun, Are We Ready for Autonomous Driving?, CVPR 2012",
            layout="training/colored_0 or training/image_0, training/flow_occ, training/flow_noc",
        ),
        DatasetMetadata(
            name="middlebury",
            title="Middlebury optical flow",
            description="Eight small scenes, real and rendered.",
            ground_truth="dense",
            licence=_NON_COMMERCIAL,
            citation="Baker et al., A Database and Evaluation Methodology for Optical Flow, IJCV 2011",
            layout="other-data/SCENE/frame10.png, other-gt-flow/SCENE/flow10.flo",
        ),
        DatasetMetadata(
            name="sintel",
            title="MPI-Sintel",
            description="23 scenes of an animated film, 1024x436, in a clean and a final rendering.",
            ground_truth="dense",
            licence="film CC BY 3.0; data for research, see the distributor's terms",
            citation="Butler et al., A Naturalistic Open Source Movie for Optical Flow Evaluation, ECCV 2012",
            layout="training/clean, training/final, training/flow, training/occlusions, training/invalid",
        ),
        DatasetMetadata(
            name="hd1k",
            title="HD1K",
            description="36 sequences of driving, 2560x1080.",
            ground_truth="sparse",
            licence=_NON_COMMERCIAL,
            citation="Kondermann et al., The HCI Benchmark Suite, CVPR Workshops 2016",
            layout="hd1k_input/image_2, hd1k_flow_gt/flow_occ",
        ),
        DatasetMetadata(
            name="spring",
            title="Spring",
            description="37 sequences of an animated film, 1920x1080, with detailed ground truth.",
            ground_truth="dense",
            licence="CC BY 4.0",
            citation="Mehl et al., Spring: A High-Resolution High-Detail Dataset and Benchmark, CVPR 2023",
            layout="train/0001/frame_left, train/0001/flow_FW_left",
        ),
        DatasetMetadata(
            name="flyingchairs",
            title="FlyingChairs",
            description="22,872 synthetic pairs of chairs moving over photographs, 512x384.",
            ground_truth="dense",
            licence=_NON_COMMERCIAL,
            citation="Dosovitskiy et al., FlowNet: Learning Optical Flow with Convolutional Networks, ICCV 2015",
            layout="data/00001_img1.ppm, data/00001_img2.ppm, data/00001_flow.flo",
        ),
        DatasetMetadata(
            name="flyingthings3d",
            title="FlyingThings3D",
            description="2,683 synthetic scenes of ten frames, 960x540.",
            ground_truth="dense",
            licence=_NON_COMMERCIAL,
            citation="Mayer et al., A Large Dataset to Train Convolutional Networks for Disparity, Optical Flow, "
            "and Scene Flow Estimation, CVPR 2016",
            layout="frames_cleanpass/TRAIN, optical_flow/TRAIN",
        ),
        DatasetMetadata(
            name="gopro",
            title="GoPro",
            description="33 hand-held sequences, 1280x720, recorded at 240 frames per second.",
            ground_truth="none",
            licence="CC BY 4.0",
            citation="Nah, Kim and Lee, Deep Multi-scale CNN for Dynamic Scene Deblurring, CVPR 2017",
            layout="train/GOPR0372_07_00/sharp, test/..., or folders of frames",
        ),
        DatasetMetadata(
            name="folder",
            title="Your own frames",
            description="Consecutive frames of a folder, of the folders in it, or of a video.",
            ground_truth="none",
            licence="yours",
            citation="none",
            layout="pictures, folders of pictures, or a video file",
        ),
        DatasetMetadata(
            name="kitti_fc",
            title="KITTI-FC, released files",
            description="KITTI 2015 as released with every corruption applied: 80 pairs in val, 120 in training.",
            ground_truth="sparse",
            licence="CC BY-NC-SA 3.0 (derived from KITTI)",
            citation="the KITTI-FC and GoPro-FC paper; Menze and Geiger, CVPR 2015",
            layout="clean/val/image_2, clean/val/flow_occ, fog_3/val/image_2",
        ),
        DatasetMetadata(
            name="gopro_fc",
            title="GoPro-FC, prepared",
            description="Pairs of key frames of clips at 960 frames per second, made by robustflow prepare gopro-fc.",
            ground_truth="none",
            licence="CC BY 4.0 (derived from GoPro)",
            citation="the KITTI-FC and GoPro-FC paper; Nah, Kim and Lee, CVPR 2017",
            layout="gopro_fc.json, GOPR0374_11_02/clip.json, GOPR0374_11_02/master.mp4, GOPR0374_11_02/keyframes",
        ),
        DatasetMetadata(
            name="gopro_fc_released",
            title="GoPro-FC, released files",
            description="Pairs of key frames of five GoPro sequences as released with every corruption applied.",
            ground_truth="none",
            licence="CC BY 4.0 (derived from GoPro)",
            citation="the KITTI-FC and GoPro-FC paper; Nah, Kim and Lee, CVPR 2017",
            layout="clean/GOPR0374_11_02, fog_3/GOPR0374_11_02",
        ),
    )
}
"""Metadata of the built-in datasets, by name. Datasets that other packages register have none here."""
