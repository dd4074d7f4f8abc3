"""The data package graspforce-problems: all cases as standard-form programs, as Parquet, JSON, CBF and QPS.

`standard_form` states a case as a program with its primal and dual optimum, or with a ray. `tags` describes it. `cbf`, `qps`
and `parquet` write the formats, `data_package` writes the package, and `reader` is the module of the written package.
"""
