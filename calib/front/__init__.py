"""The front door: what a notebook says, in as many words. The names stand in `calib` itself."""
