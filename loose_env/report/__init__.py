"""The page that shows how agents did: words, a table, figures and one episode in pictures."""
