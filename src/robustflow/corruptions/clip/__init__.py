"""The five corruptions that need the whole clip around a pair: names and numbers; `robustflow.video` does the work."""
