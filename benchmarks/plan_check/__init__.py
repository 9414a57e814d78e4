"""An independent check of plans: claim beside truth.

Nothing of compplan is imported here. The command line is called as a user calls it; its joints.csv is then judged by a
cell that shares no code with the product: an own reader of URDF, elasticity.toml, job and toolpath, an own force law at
the feed that joints.csv drives, and MuJoCo's rigid bodies brought to rest on elastic hinges and slides.

    python -m benchmarks plan_check --out DIR [--jobs NAME ...]
"""
