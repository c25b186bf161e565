"""A sweep on the workers of a Dask cluster, as beyond one machine."""

from pathlib import Path

import pytest

import magmpm

distributed = pytest.importorskip("distributed", reason="pip install distributed")
SCENE = Path(__file__).parents[2] / "data/scenes/five_segments.yaml"


def test_a_sweep_on_two_dask_workers_is_that_of_one_process(tmp_path: Path) -> None:
    """Row by row, bit for bit; and its folder goes on without the cluster."""
    scene = magmpm.load_scene(SCENE).with_cells(2)
    values = {"field.uniform[2]": ["1 mT", "2 mT", "4 mT"], "effects.gravity": [None, {}]}
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        executor = client.get_executor()
        there = magmpm.sweep(scene, values, executor=executor, folder=tmp_path / "sweep")
    alone = magmpm.sweep(scene, values, workers=1)
    assert there.rows == alone.rows
    assert len(there) == 6
    again = magmpm.sweep(scene, values, workers=1, folder=tmp_path / "sweep")
    assert again.rows == alone.rows
