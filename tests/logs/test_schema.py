"""The schema of a log."""

from psmpc_cli.logs.schema import SCHEMA


def test_every_dimension_has_its_scale() -> None:
    scales = {column.path for column in SCHEMA if column.is_scale} | {f"{c.path}_element" for c in SCHEMA if c.ragged}
    assert {dim for column in SCHEMA for dim in column.dims} == scales
    assert len({column.path for column in SCHEMA}) == len(SCHEMA)
