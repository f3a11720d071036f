"""Every corruption works in torch DataLoader workers after torch and OpenCV have used threads in the parent.

A thread pool does not survive a fork: a worker that uses one hangs, so each case runs in a separate process with a time
limit.
"""

import os
import subprocess
import sys
import textwrap

import pytest

from robustflow.corruptions import IMAGE_PAIR

pytest.importorskip("torch")

SCRIPT = textwrap.dedent(
    """
    import sys

    import cv2
    import numpy as np
    import torch

    from robustflow.corruptions.transform import CorruptionTransform

    NAMES = sys.argv[2].split(",")


    class Pairs(torch.utils.data.Dataset):
        def __len__(self):
            return len(NAMES)

        def __getitem__(self, index):
            image = (np.indices((160, 224)).sum(0)[..., None] * [1, 2, 3] % 256).astype(np.uint8)
            first, second = CorruptionTransform([NAMES[index]], severities=[3])([image, image], key=index)
            assert first.shape == image.shape and (first != image).any() | (second != image).any(), NAMES[index]
            import numba.np.ufunc.parallel as parallel

            assert not parallel._is_initialized, f"{NAMES[index]} started numba's threads"
            return NAMES[index], torch.from_numpy(first).float().mean()


    if __name__ == "__main__":
        cv2.GaussianBlur(np.zeros((2000, 2000, 3), np.uint8), (0, 0), 5)
        torch.mm(torch.ones(600, 600), torch.ones(600, 600)).sum()
        loader = torch.utils.data.DataLoader(
            Pairs(), batch_size=None, num_workers=2, multiprocessing_context=sys.argv[1], collate_fn=list
        )
        print(",".join(sorted(name for name, _ in loader)))
    """
)


@pytest.mark.parametrize("start", ["fork", "spawn"])
def test_no_corruption_hangs_in_a_worker(start, tmp_path):
    if start == "fork" and sys.platform != "linux":
        pytest.skip("fork is the default only on Linux")
    script = tmp_path / "load.py"
    script.write_text(SCRIPT)
    names = [*IMAGE_PAIR, "elastic_transform"]
    threads = {"OMP_NUM_THREADS": "4", "NUMBA_NUM_THREADS": "4", "OPENBLAS_NUM_THREADS": "1"}
    environment = {**os.environ, **threads}
    done = subprocess.run(
        [sys.executable, str(script), start, ",".join(names)],
        capture_output=True, text=True, timeout=150, env=environment, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout.split() == [",".join(sorted(names))]
