"""Arms that come with the package.

Data flow: planar -> puma560 -> scara -> vera.
"""
