"""The version of the package: of the git tag that it was built from."""

from importlib import metadata

try:
    VERSION = metadata.version("compplan")
except metadata.PackageNotFoundError:  # a checkout that is not installed
    VERSION = "0.1.0"
