"""The job file: schema, checks, commented text, frames, tools."""
