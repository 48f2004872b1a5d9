"""Presentation shared by all subjects: units, tables, sentences, HTML, figures."""
