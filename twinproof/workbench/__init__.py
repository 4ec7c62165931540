"""The journey of the command line in a browser.

A project is a folder of plain files (`project`); what takes long runs in a process of its own that
can be ended (`worker`, `tasks`); the server (`server`) hands out both to one page (`static`).
"""
