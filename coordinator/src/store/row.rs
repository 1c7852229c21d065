//! Defines `from_row!`, which reads the columns of a row into the fields of the same names. It replaces sqlx's derive
//! macro, for which SQLite would be built a second time, as a part of the compiler's plug-in.

macro_rules! from_row {
    ($row:ident$(<$life:lifetime>)? { $($column:ident),+ }) => {
        impl<'r> sqlx::FromRow<'r, sqlx::sqlite::SqliteRow> for $row$(<$life>)? {
            fn from_row(row: &'r sqlx::sqlite::SqliteRow) -> sqlx::Result<Self> {
                Ok(Self { $($column: sqlx::Row::try_get(row, stringify!($column))?),+ })
            }
        }
    };
}
