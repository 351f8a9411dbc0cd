"""Parts that several studies share, or that one study has beside its script."""
