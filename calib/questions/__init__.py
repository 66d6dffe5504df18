"""The questions a study is asked, one file each: tables out, nothing drawn and nothing printed."""
