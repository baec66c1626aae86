"""YAML and overrides become one checked, frozen configuration."""

from sb3_stereo.config.schema import Config, load_config

__all__ = ["Config", "load_config"]
