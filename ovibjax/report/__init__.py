"""Claims, figures, tables and pages: general tools that know nothing of localization."""
