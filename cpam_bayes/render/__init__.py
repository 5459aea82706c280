"""Reports as screens, pages, documents, tables and figures; computes nothing."""
