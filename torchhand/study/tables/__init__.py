"""What studies found, in formats of other programs."""

from torchhand.study.tables.parquet import write_parquet

__all__ = ["write_parquet"]
