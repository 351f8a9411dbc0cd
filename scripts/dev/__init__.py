"""Scripts for developers: documents, pictures, benchmarks, smoke test."""
