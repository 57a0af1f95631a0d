"""Prints a description of a Parquet file, as pandas reads it, as a JSON object: `columns`, the
dtype of each column and the Python types of its values ({"camera": ["boolean", ["bool"]], ...});
`gaps`, the number of absent values of each column; `objects`, the columns of dtype object;
`camera`, the number of successes under camera.

    python3 columns.py table.parquet"""

import json
import sys

import pyarrow.parquet

frame = pyarrow.parquet.read_table(sys.argv[1]).to_pandas()
kinds = {
    name: [str(column.dtype), sorted({type(value).__name__ for value in column.dropna()})]
    for name, column in frame.items()
}
gaps = {name: int(column.isna().sum()) for name, column in frame.items()}
mixed = [name for name, column in frame.items() if column.dtype == object]
# pandas must count successes without a cast.
successes = int(frame["camera"].sum())
json.dump({"columns": kinds, "gaps": gaps, "objects": mixed, "camera": successes}, sys.stdout)
