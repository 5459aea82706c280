"""The paper's tables in the digits of the print, and its noise study."""
