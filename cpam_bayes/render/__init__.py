"""Renderings of reports: screens, pages, documents, tables and figures; nothing is computed."""
