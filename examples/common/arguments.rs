//! The command line: a thin layer over `lexopt`: values with messages that say which option is wrong and why.

use std::error::Error;
use std::ffi::OsString;
use std::fmt::Display;
use std::path::PathBuf;
use std::process::ExitCode;
use std::str::FromStr;

/// The command line, read one option at a time.
pub struct Arguments {
    parser: lexopt::Parser,
    option: String,
}

impl Arguments {
    /// The arguments of this process.
    pub fn from_env() -> Arguments {
        Arguments { parser: lexopt::Parser::from_env(), option: String::new() }
    }

    /// The next option, with its dashes. Anything else on the command line is an error.
    pub fn option(&mut self) -> Result<Option<String>, Box<dyn Error>> {
        self.option_or(|path| Err(format!("{}: unexpected; --help tells what is", path.display()).into()))
    }

    /// The next option, with its dashes. One argument that is none may stand between them, and becomes `model`.
    pub fn option_or_model(&mut self, model: &mut Option<PathBuf>) -> Result<Option<String>, Box<dyn Error>> {
        self.option_or(|path| match model {
            Some(_) => Err(format!("{}: one model at a time", path.display()).into()),
            None => {
                *model = Some(path);
                Ok(())
            }
        })
    }

    /// The next option; `positional` takes what stands before it.
    fn option_or(
        &mut self,
        mut positional: impl FnMut(PathBuf) -> Result<(), Box<dyn Error>>,
    ) -> Result<Option<String>, Box<dyn Error>> {
        loop {
            let name = match self.parser.next()? {
                Some(lexopt::Arg::Short(c)) => format!("-{c}"),
                Some(lexopt::Arg::Long(name)) => format!("--{name}"),
                Some(lexopt::Arg::Value(value)) => {
                    positional(value.into())?;
                    continue;
                }
                None => return Ok(None),
            };
            self.option.clone_from(&name);
            return Ok(Some(name));
        }
    }

    /// The error for the option that came last, if nobody knows it.
    pub fn unknown(&self) -> Box<dyn Error> {
        format!("{}: no such option; --help lists them", self.option).into()
    }

    /// The value of the option that came last, as text.
    pub fn text(&mut self) -> Result<String, Box<dyn Error>> {
        let option = self.option.clone();
        self.raw()?.into_string().map_err(|_| format!("{option}: not valid Unicode").into())
    }

    /// The value of the option that came last, as a path.
    pub fn path(&mut self) -> Result<PathBuf, Box<dyn Error>> {
        self.raw().map(PathBuf::from)
    }

    /// The value of the option that came last.
    pub fn value<T: FromStr<Err: Display>>(&mut self) -> Result<T, Box<dyn Error>> {
        let text = self.text()?;
        text.parse().map_err(|error| format!("{} {text}: {error}", self.option).into())
    }

    /// The value of the option that came last: `COUNT` numbers with commas between them.
    pub fn numbers<const COUNT: usize>(&mut self) -> Result<[f64; COUNT], Box<dyn Error>> {
        let numbers = self.number_list()?;
        <[f64; COUNT]>::try_from(numbers)
            .map_err(|_| format!("{}: expected {COUNT} numbers with commas between", self.option).into())
    }

    /// The value of the option that came last: any count of finite numbers with commas between them.
    pub fn number_list(&mut self) -> Result<Vec<f64>, Box<dyn Error>> {
        let text = self.text()?;
        let number = |part: &str| part.trim().parse().ok().filter(|x: &f64| x.is_finite());
        let numbers: Option<Vec<f64>> = text.split(',').map(number).collect();
        numbers.ok_or_else(|| format!("{} {text}: expected numbers with commas between", self.option).into())
    }

    /// The value of the option that came last: one of the given names.
    pub fn choice<T: Copy>(&mut self, choices: &[(&str, T)]) -> Result<T, Box<dyn Error>> {
        let text = self.text()?;
        match choices.iter().find(|(name, _)| *name == text) {
            Some((_, value)) => Ok(*value),
            None => {
                let names: Vec<&str> = choices.iter().map(|(name, _)| *name).collect();
                Err(format!("{} {text}: expected one of {}", self.option, names.join(", ")).into())
            }
        }
    }

    /// The value of the option that came last: `640x480`, or `512` for a square.
    pub fn size(&mut self) -> Result<[u32; 2], Box<dyn Error>> {
        let text = self.text()?;
        let error = || format!("{} {text}: write it as 640x480, or 512 for a square", self.option);
        let (width, height) = text.split_once('x').unwrap_or((&text, &text));
        Ok([width.parse().map_err(|_| error())?, height.parse().map_err(|_| error())?])
    }

    fn raw(&mut self) -> Result<OsString, Box<dyn Error>> {
        self.parser.value().map_err(|_| format!("{}: a value is missing", self.option).into())
    }
}

/// Runs `main` and turns an error into a message and exit code 1.
pub fn run(main: impl FnOnce(Arguments) -> Result<ExitCode, Box<dyn Error>>) -> ExitCode {
    match main(Arguments::from_env()) {
        Ok(code) => code,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}
