# SPDX-License-Identifier: Apache-2.0
"""Stages behind a controller that speaks PI's General Command Set 2.0: a client, and a server.

Written from the public manuals alone, see ``docs/decisions``; no vendor's software is used. The
server answers as such a controller would, around a simulated stage.
"""
