"""Checks of what agents say of themselves, against simulation."""
