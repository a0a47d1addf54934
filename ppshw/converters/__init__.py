"""Published recordings of real machines → the contract's CSV (docs/real-data.md).

One module per data set, each with `convert(source, out_csv) -> visits`. The raw files stay out of the repository.
    python -m ppshw.converters hilti ../shared/data/hilti/flat.yaml flat.csv
"""
