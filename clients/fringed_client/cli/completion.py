"""`fringe completion`: the script that a shell reads."""

from __future__ import annotations

import click

_HOW = {
    "bash": 'eval "$(fringe completion bash)"   # in ~/.bashrc',
    "zsh": 'eval "$(fringe completion zsh)"   # in ~/.zshrc',
    "fish": "fringe completion fish > ~/.config/fish/completions/fringe.fish",
}


@click.command("completion", epilog="\b\n" + "\n".join(f"{shell}: {how}" for shell, how in _HOW.items()))
@click.argument("shell", type=click.Choice(sorted(_HOW)))
def completion_command(shell: str) -> None:
    """Print the completion script of a shell."""
    from click.shell_completion import get_completion_class

    from fringed_client.cli.main import cli

    found = get_completion_class(shell)
    assert found is not None
    maker = found(cli, {}, "fringe", "_FRINGE_COMPLETE")
    click.echo(maker.source_template % maker.source_vars())
