"""The doctor: what is odd about an installation, a robot folder or a measurement log; it repairs nothing."""
