"""The job file: what it may say, its check, its commented text, and the noise of a study."""
