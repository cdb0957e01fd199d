"""Plain data as YAML 1.2 text that reads back as the same data."""

import yaml

from psmpc_cli.specs.document import Data
from psmpc_cli.specs.scalars import resolve


class _Writer(yaml.SafeDumper):
    """PyYAML's writer, without anchors."""

    def ignore_aliases(self, data: object) -> bool:
        """Write everything out."""
        return True


def write(data: Data) -> str:
    """Return data as YAML, keys in their order, short lists on one line."""
    _Writer.add_representer(str, _text)
    return yaml.dump(data, Dumper=_Writer, sort_keys=False, default_flow_style=None, allow_unicode=True, width=120)


def _text(writer: yaml.SafeDumper, text: str) -> yaml.ScalarNode:
    """Quote a text that YAML 1.2 would take for something else; PyYAML sees to YAML 1.1."""
    style = None if isinstance(resolve(text), str) else '"'
    return writer.represent_scalar("tag:yaml.org,2002:str", text, style=style)
