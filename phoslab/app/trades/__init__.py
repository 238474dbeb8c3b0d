"""Speed against accuracy, measured on this machine: one module a trade, one page and one trade.json each."""
