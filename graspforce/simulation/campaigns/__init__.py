"""Campaigns: trials in random worlds, the outcome of each, and files of results that can be continued."""
