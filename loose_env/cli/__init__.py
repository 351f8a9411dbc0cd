"""Package of the command ``loose``; `main` runs it, `command` parses for it and for the scripts."""
